"""Writes sealed cases, and their answers to a file of their own."""

import hashlib
import json
import shutil
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from keycld_control.benchmarks.blind.case import (
    HELD_OUT,
    SECONDS,
    TRAINING,
    SealedCase,
    Signals,
    draw_case,
    reading_deviation,
    recording,
)
from keycld_control.benchmarks.blind.film import Studio
from keycld_control.benchmarks.blind.grade import gains, grade
from keycld_control.benchmarks.blind.mechanism import Array
from keycld_control.benchmarks.blind.mechanisms.forces import Pushes
from keycld_control.benchmarks.blind.plan import CATEGORIES, Category, Plan, mix, plan
from keycld_control.benchmarks.blind.sites import environment_of
from keycld_control.benchmarks.blind.strengths import place
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file, atomic_folder, one_writer
from keycld_envs.progress import progress
from keycld_envs.reading import read_json
from keycld_envs.recordings import write_recording
from keycld_envs.workers import each

SCHEMA = "keycld.blind/1"
GENERATOR = "3"
"""Raised whenever the same seed gives other recordings."""
ROLLOUT = 160
"""Samples of a long rollout, whose initial state is fitted, for the error that nobody can beat."""


@dataclass(frozen=True)
class Settings:
    """What determines every byte of the cases and their answers.

    Attributes:
        seed: of all random numbers.
        cases: their number.
        observe: "states", what encoders show, or "pixels", frames alone.
        only: categories of cases.
    """

    seed: int
    cases: int
    observe: Literal["states", "pixels"] = "states"
    only: tuple[Category, ...] = CATEGORIES

    @cached_property
    def plans(self) -> list[Plan]:
        """What the cases are."""
        return plan(self.cases, self.seed, self.only)


def make(out: Path, settings: Settings, workers: int = 1, ray: str | None = None) -> dict[str, Any]:
    """Write the cases that are not there yet, then the answers and the manifest.

    Args:
        out: folder of the benchmark.
        settings: what to make.
        workers: processes.
        ray: address of a Ray cluster to do it on instead.

    Returns:
        The manifest.

    Raises:
        InputError: if the folder holds a benchmark with other settings, or something else.
    """
    out = out.resolve()
    if settings.cases < 1 or settings.seed < 0 or workers < 1:
        raise InputError("cases and workers must be at least 1, and seed at least 0.")
    if not settings.only:
        raise InputError(f"only is empty; name categories of cases: {', '.join(CATEGORIES)}.")
    plans, settled = settings.plans, out / "settings.json"
    content = json.dumps({"schema": SCHEMA, "generator": GENERATOR, **asdict(settings)}, indent=1) + "\n"
    with one_writer(out):
        if settled.is_file():
            if settled.read_text(encoding="utf-8") != content:
                raise InputError(f"{settled} is of a benchmark with other settings; choose another folder.")
        elif any(not path.name.startswith(".") for path in out.iterdir()):
            raise InputError(f"{out} exists and was not made by `keycld blind make`; choose another folder.")
        else:
            with atomic_file(settled, "w") as file:
                file.write(content)
        if not (out / "manifest.json").is_file():
            todo = [i for i in range(len(plans)) if not (_folder(out, i).is_dir() and _sealed(out, i).is_file())]
            with progress("Making", total=len(plans)) as advance:
                advance(len(plans) - len(todo))
                for _ in each(partial(_make, out, settings), todo, workers, ray):
                    advance()
            _publish(out, settings, plans)
    return read_json(out / "manifest.json")


def name(index: int) -> str:
    """The number of a case as its folder and files are named."""
    return f"{index + 1:04d}"


def _folder(out: Path, index: int) -> Path:
    return out / "cases" / name(index)


def _sealed(out: Path, index: int) -> Path:
    return out / ".answers" / f"{name(index)}.json"


def _make(out: Path, settings: Settings, index: int) -> None:
    """Write one case: its answer first, then its folder, complete or not at all."""
    filmed = settings.observe == "pixels"
    case, signals = draw_case(settings.plans[index], (settings.seed, 1, index), filmed)
    folder = _folder(out, index)
    with Studio(case.plan.system, case.errors) if filmed else nullcontext() as studio:
        noise = case.noise if studio is None else reading_deviation(case, signals[:TRAINING], studio)
        with atomic_file(_sealed(out, index), "w") as file:
            json.dump(answer(case, signals, index, noise), file)
        shutil.rmtree(folder, ignore_errors=True)
        with atomic_folder(folder) as partial_folder:
            for run, s in enumerate(signals):
                part = "training" if run < TRAINING else "held_out"
                visible = recording(case, run, s, studio)
                write_recording(partial_folder / part / visible.id, visible)
            about = {
                "schema": SCHEMA,
                "id": name(index),
                "system": environment_of(case.plan.system),
                "observe": settings.observe,
                "excitation": case.plan.excitation,
            }
            (partial_folder / "case.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def answer(case: SealedCase, signals: list[Signals], index: int, noise: Array) -> dict[str, Any]:
    """Everything that was drawn, and how visible it is where positions are known as well as `noise` `[nv]`."""
    together, singles = gains(case, signals, noise)
    held_out = np.concatenate([(s.noise - case.zero).ravel() for s in signals[TRAINING:]])
    return {
        "case": name(index),
        "category": case.plan.category,
        "system": case.plan.system,
        "excitation": case.plan.excitation,
        "gain_nats": together,
        "grade": grade(together),
        "truth": [_truth(case, i, signals, nats) for i, nats in enumerate(singles)],
        "oracle": {
            "metric": "held-out noise",
            "unit": "mrad or mm",
            "value": 1e3 * float(remaining(len(signals[-1].t_state)) * np.std(held_out)) if case.film is None else None,
        },
        "film": None if case.film is None else case.film.answer(),
        "nuisance": {**asdict(case.errors), "zero": case.zero.tolist()},
        "noise": noise.tolist(),
        "rate": case.rate,
        "jitter": case.jitter,
        "smooth": case.smooth,
        "levels": [s.level for s in signals],
        "driven": case.driven if case.plan.excitation == "mixed" else None,
        "attempts": [case.entropy[-1], *(s.attempt for s in signals)],
        "moved": np.max([np.ptp(s.true, axis=0) for s in signals[:TRAINING]], axis=0).tolist(),
    }


def remaining(samples: int) -> float:
    """Root of the share of degrees of freedom that are left when two numbers per joint and rollout are fitted."""
    return float(np.sqrt(1 - 2 / min(ROLLOUT, samples)))


def _truth(case: SealedCase, index: int, signals: list[Signals], nats: float) -> dict[str, Any]:
    mechanism, (_, site) = case.mechanisms[index], case.plan.parts[index]
    out: dict[str, Any] = {
        "effect": mechanism.id,
        "where": place(mechanism, site),
        "joint": site.name,
        "parameters": mechanism.parameters(),
        "comparable": mechanism.comparable(),
        "gain_nats": nats,
        "grade": grade(nats),
    }
    if isinstance(mechanism, Pushes):
        out["when_by_recording"] = {f"{run + 1:02d}": pulses(case, run, s) for run, s in enumerate(signals)}
    return out


def pulses(case: SealedCase, run: int, signals: Signals) -> list[tuple[float, float, float]]:
    """Start, end (s) and force of the pushes in one recording, drawn again as the plant drew them."""
    rng = case.stream(run, signals.attempt, "mechanisms")
    out: list[tuple[float, float, float]] = []
    for mechanism in case.mechanisms:
        if isinstance(mechanism, Pushes):
            out += mechanism.windows(rng, SECONDS)
    return out


def _publish(out: Path, settings: Settings, plans: list[Plan]) -> None:
    answers = [json.loads(_sealed(out, i).read_text(encoding="utf-8")) for i in range(len(plans))]
    content = (json.dumps(answers, indent=1) + "\n").encode()
    with atomic_file(out / "answers.json") as file:
        file.write(content)
    manifest = {
        "schema": SCHEMA,
        "generator": GENERATOR,
        **asdict(settings),
        "mix": mix(plans),
        "recordings": {"training": TRAINING, "held_out": HELD_OUT, "seconds": SECONDS},
        "answers_sha256": hashlib.sha256(content).hexdigest(),
    }
    with atomic_file(out / "manifest.json", "w") as file:
        file.write(json.dumps(manifest, indent=1) + "\n")
    shutil.rmtree(out / ".answers")
