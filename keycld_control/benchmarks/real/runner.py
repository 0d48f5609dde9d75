"""Runs a gate: reads its recordings, diagnoses them, and checks what was found."""

import time
from collections.abc import Mapping
from pathlib import Path

from keycld_control.benchmarks.real.concealed import ALL, ConcealedGate, Running
from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Gate, GateResult, Outcome
from keycld_control.benchmarks.real.halves import HalvesGate
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.replay import curves
from keycld_control.benchmarks.refitting import split
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import diagnose

AnyGate = Gate | ConcealedGate | HalvesGate | OwnersGate


def run(gate: AnyGate, folder: Path, running: Running = ALL) -> GateResult:
    """The result of a gate on the data sets of a folder; `running` is for gates of concealed effects.

    An error ends the gate and is part of its result, with the reports of the diagnoses that were completed before.
    """
    if isinstance(gate, ConcealedGate):
        return gate.run(folder, running)
    if not isinstance(gate, Gate):
        return gate.run(folder)
    start, error, drawn = time.perf_counter(), None, []
    diagnosed: dict[str, Diagnosed] = {}
    try:
        recordings = {name: _read(data, folder) for name, data in gate.diagnoses.items()}  # all, before the first one
        for name, parts in recordings.items():
            diagnosed[name] = _diagnosed(gate, name, parts, folder)
        outcome = _outcome(gate, diagnosed)
        drawn = [c for d in diagnosed.values() for c in curves(d.report, d.model, d.held_out, gate.plotted)]
    except Exception as failure:
        error, outcome = failure, Outcome.failed(failure)
    return GateResult.of(gate, outcome, start, {name: d.report for name, d in diagnosed.items()}, error, drawn)


def _read(data: DataSplit, folder: Path) -> tuple[list[Recording], ...]:
    """Recordings, held-out ones, and the baseline."""
    return tuple([f.recording(folder) for f in files] for files in (data.recordings, data.held_out, data.baseline))


def _diagnosed(gate: Gate, name: str, parts: tuple[list[Recording], ...], folder: Path) -> Diagnosed:
    model, start = gate.simulator(folder), time.perf_counter()
    recordings, held_out, baseline = parts
    tables = [file.table(folder) for file in gate.diagnoses[name].recordings]
    report = diagnose(recordings, model, held_out, gate.tracked, baseline=baseline)
    seconds, training = round(time.perf_counter() - start, 1), recordings
    if not held_out:
        training, held_out = (recordings, recordings) if baseline else split(recordings, model)
    return Diagnosed(model, tables, recordings, training, held_out, report, seconds)


def _outcome(gate: Gate, diagnosed: Mapping[str, Diagnosed]) -> Outcome:
    """What each diagnosis found, and what of the expectations it does not meet."""
    reached, passed = [], True
    numbers: dict[str, object] = {}
    for name, one in diagnosed.items():
        checks = [(e, e.check(one)) for e in gate.expectations if not e.of or name in e.of]
        missed = [e.required() for e, outcome in checks if not outcome.passed]
        words = [one.describe(), *(outcome.reached for _, outcome in checks if outcome.reached)]
        words += [f"missed: {'; '.join(missed)}"] if missed else []
        reached.append((f"{name}: " if len(diagnosed) > 1 else "") + "; ".join(words))
        passed &= not missed
        numbers[name] = {
            "checks": [{"required": e.required(), "passed": o.passed} | dict(o.numbers) for e, o in checks],
            "errors": one.errors,
            "diagnosis_s": one.seconds,
        }
    return Outcome(". ".join(reached), passed, numbers)
