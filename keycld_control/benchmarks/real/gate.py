"""What a gate is: a diagnosis of somebody's real mechanism, and what it must show."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.diagnose import diagnose
from keycld_model.diagnosis.verdict.report import Finding, Report

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """One joint of one recording that was held out.

    Attributes:
        title: which.
        unit: of the positions.
        time: `[N]` s.
        measured: `[N]`.
        predicted: `[N]` by simulator: with its own numbers refitted, and with the findings added.
    """

    title: str
    unit: str
    time: Array
    measured: Array
    predicted: Mapping[str, Array]


@dataclass(frozen=True)
class GateResult:
    """What came of a gate.

    Attributes:
        gate: its name, "R3".
        title: the mechanism.
        required: what must be shown.
        reached: what was.
        passed: whether it suffices.
        numbers: everything measured, JSON-compatible.
        seconds: that it took.
        reports: of the diagnoses, by name.
        curves: for plots.
    """

    gate: str
    title: str
    required: str
    reached: str
    passed: bool
    numbers: Mapping[str, Any]
    seconds: float
    reports: Mapping[str, Report] = field(default_factory=dict)
    curves: Sequence[Curve] = ()

    def to_dict(self) -> dict[str, Any]:
        """JSON-compatible, without the curves."""
        names = ("gate", "title", "required", "reached", "passed", "numbers", "seconds")
        return {name: getattr(self, name) for name in names} | {
            "reports": {name: report.to_dict() for name, report in self.reports.items()}
        }


Gate = Callable[[Path], GateResult]


def locate(folder: Path, path: str) -> Path:
    """A file of a data set.

    Raises:
        InputError: if it is not there.
    """
    if not (folder / path).is_file():
        raise InputError(f"{folder / path} does not exist; docs/real-data.md says where to get it.")
    return folder / path


def timed_diagnosis(
    recordings: Sequence[Recording],
    model: mujoco.MjModel,
    held_out: Sequence[Recording] = (),
    tracked: bool = False,
) -> tuple[Report, float]:
    """The report, and the seconds that it took."""
    start = time.perf_counter()
    report = diagnose(recordings, model, held_out, tracked)
    return report, round(time.perf_counter() - start, 1)


def find(report: Report, effect: str, where: str | None = None) -> Finding | None:
    """A finding, if there is one."""
    found = (f for f in report.findings if f.effect == effect and where in (None, f.where["name"]))
    return next(found, None)


def describe(report: Report) -> str:
    """The findings in one line."""
    return (
        "; ".join(
            f"{f.effect} at {f.where['name']} ("
            + ", ".join(f"{n} = {e.value:.3g} [{e.low:.3g}, {e.high:.3g}] {e.unit}" for n, e in f.parameters.items())
            + ")"
            for f in report.findings
        )
        or report.verdict
    )
