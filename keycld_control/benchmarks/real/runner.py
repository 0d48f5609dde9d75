"""Runs a gate: reads its recordings, diagnoses them, and checks what was found."""

import time
from collections.abc import Sequence
from pathlib import Path

from keycld_control.benchmarks.real.concealed import ConcealedGate
from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Gate, GateResult, Outcome
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.replay import curves
from keycld_control.benchmarks.refitting import split
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Table
from keycld_model.diagnosis import diagnose


def run(gate: Gate | ConcealedGate | OwnersGate, folder: Path) -> GateResult:
    """The result of a gate on the data sets of a folder.

    An error ends the gate and is part of its result, with the reports of the diagnoses that were completed before.
    """
    if not isinstance(gate, Gate):
        return gate.run(folder)
    start, error, drawn = time.perf_counter(), None, []
    diagnoses: dict[str, Diagnosed] = {}
    try:
        recordings = {name: _read(data, folder) for name, data in gate.data.items()}  # all, before the first diagnosis
        for name, (training, held_out) in recordings.items():
            tables = [file.table(folder) for file in gate.data[name].training]
            diagnoses[name] = _diagnose(gate, tables, training, held_out)
        outcome = gate.check(diagnoses)
        if gate.plotted is not None:
            drawn = [curve for d in diagnoses.values() for curve in curves(d.report, d.model, d.held_out, gate.plotted)]
    except Exception as failure:
        error, outcome = failure, Outcome(f"could not run: {failure}", False)
    return GateResult(
        gate=gate.name,
        title=gate.title,
        required=gate.required,
        reached=outcome.reached,
        passed=outcome.passed,
        numbers=outcome.numbers,
        seconds=round(time.perf_counter() - start, 1),
        reports={name: d.report for name, d in diagnoses.items()},
        curves=drawn,
        error=error,
    )


def _read(data: DataSplit, folder: Path) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings."""
    return [file.recording(folder) for file in data.training], [file.recording(folder) for file in data.held_out]


def _diagnose(
    gate: Gate, tables: Sequence[Table], training: Sequence[Recording], held_out: Sequence[Recording]
) -> Diagnosed:
    model, start = gate.simulator(), time.perf_counter()
    report = diagnose(training, model, held_out, gate.tracked)
    seconds = round(time.perf_counter() - start, 1)
    if not held_out:
        training, held_out = split(training, model)
    return Diagnosed(model, tables, training, held_out, report, seconds)
