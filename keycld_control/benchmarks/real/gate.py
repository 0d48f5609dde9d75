"""A gate: what the diagnosis is given of somebody's real mechanism, and what it must show."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.refitting import Finding
from keycld_envs.effects import effect_class
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Columns, Table, assemble, read_csv
from keycld_model.diagnosis import Report

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RecordingFile:
    """A file of a data set, or the part of one, that is one recording.

    Attributes:
        path: of the file, from the folder that holds all data sets.
        columns: which column is what.
        id: of the recording.
        licence: of the data.
        origin: where the data come from.
        reader: of the file's format.
    """

    path: str
    columns: Columns
    id: str
    licence: str
    origin: str
    reader: Callable[[Path], Table] = read_csv

    def table(self, folder: Path) -> Table:
        """Everything in the file.

        Raises:
            InputError: if the file is not there.
        """
        if not (folder / self.path).is_file():
            raise InputError(f"{folder / self.path} does not exist; docs/real-data.md says where to get it.")
        return self.reader(folder / self.path)

    def recording(self, folder: Path) -> Recording:
        """The recording.

        Raises:
            InputError: if the file or a column is not there.
        """
        return assemble(self.table(folder), self.columns, self.id, licence=self.licence, origin=self.origin)


@dataclass(frozen=True)
class DataSplit:
    """The files of one diagnosis.

    Attributes:
        recordings: to learn from.
        held_out: to test on; without any, the diagnosis holds out a part by itself.
        baseline: of the mechanism before; with it, the question is what changed.
    """

    recordings: Sequence[RecordingFile]
    held_out: Sequence[RecordingFile] = ()
    baseline: Sequence[RecordingFile] = ()


@dataclass(frozen=True)
class Runs:
    """Runs of one rig, from which a gate draws.

    Attributes:
        name: of the rig.
        simulator: makes its model, of the folder with the data.
        files: one per run.
        left: root mean square of what a simulator with friction leaves over 0.2 s, N m; for effects to be concealed.
    """

    name: str
    simulator: Callable[[Path], mujoco.MjModel]
    files: Sequence[RecordingFile]
    left: float = 0.0


@dataclass(frozen=True)
class Diagnosed:
    """One diagnosis of a gate, and what it was given.

    Attributes:
        model: the simulator.
        tables: all that the files hold of `recordings`, also what was hidden from the diagnosis.
        recordings: that were handed in.
        training: those of them that it learned from.
        held_out: recordings to test on.
        report: of the diagnosis.
        seconds: that it took.
    """

    model: mujoco.MjModel
    tables: Sequence[Table]
    recordings: Sequence[Recording]
    training: Sequence[Recording]
    held_out: Sequence[Recording]
    report: Report
    seconds: float

    @property
    def errors(self) -> list[float]:
        """Held-out errors of the nominal, the refitted and the corrected simulator, mrad or mm."""
        fit = self.report.fit
        return [fit.nominal, fit.refitted, fit.corrected]

    def describe(self) -> str:
        """The findings with their parameters in one line, or the verdict if there are none."""
        findings = [
            f"{f.effect} at {f.where['name']} ("
            + ", ".join(f"{n} = {e.value:.3g} [{e.low:.3g}, {e.high:.3g}] {e.unit}" for n, e in f.parameters.items())
            + ")"
            for f in self.report.findings
        ]
        return "; ".join(findings) or self.report.verdict


def group_of(finding: Finding) -> str:
    """Group of effects that do nearly the same, such as "dry friction", or the slot of the equations."""
    kind = effect_class(finding.effect, finding.where["kind"])
    return kind.confusable.group if kind is not None and kind.confusable is not None else finding.family


@dataclass(frozen=True)
class Outcome:
    """What a check says of a diagnosis.

    Attributes:
        reached: in words.
        passed: whether it suffices.
        numbers: everything measured, JSON-compatible.
    """

    reached: str
    passed: bool
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def failed(cls, error: Exception, numbers: Mapping[str, Any] | None = None) -> "Outcome":
        """Of a gate that an error ended, with what was measured before."""
        return cls(f"could not run: {error}", False, numbers or {})


class Expectation(Protocol):
    """Something that a diagnosis must show."""

    @property
    def of(self) -> tuple[str, ...]:
        """Names of the diagnoses that must show it; all, if there are none."""
        ...

    def required(self) -> str:
        """What, in words."""
        ...

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """Whether one does."""
        ...


@dataclass(frozen=True)
class Gate:
    """What the diagnosis is given, and what it must show.

    Attributes:
        name: "R3".
        title: the mechanism.
        simulator: makes its model, of the folder with the data.
        diagnoses: files by the name of the diagnosis; each is one call.
        expectations: all must be met.
        tracked: positions were read off a video.
        plotted: length of the rollouts that are drawn, s.
    """

    name: str
    title: str
    simulator: Callable[[Path], mujoco.MjModel]
    diagnoses: Mapping[str, DataSplit]
    expectations: Sequence[Expectation]
    tracked: bool = False
    plotted: float = 1.0

    @property
    def required(self) -> str:
        """What must be shown, in words."""
        return "; ".join(e.required() + (f" ({', '.join(e.of)})" if e.of else "") for e in self.expectations)


@dataclass(frozen=True)
class Curve:
    """One joint of one recording that was held out.

    Attributes:
        title: recording and joint.
        unit: of the positions.
        time: `[N]` s.
        measured: `[N]` positions.
        predicted: `[N]` positions by simulator: "refitted" with its own parameters, "corrected" with the findings.
    """

    title: str
    unit: str
    time: Array
    measured: Array
    predicted: Mapping[str, Array]


class Titled(Protocol):
    """What every gate has."""

    @property
    def name(self) -> str:
        """Such as "G3"."""
        ...

    @property
    def title(self) -> str:
        """The mechanism."""
        ...

    @property
    def required(self) -> str:
        """What must be shown, in words."""
        ...


@dataclass(frozen=True)
class GateResult:
    """What came of a gate.

    Attributes:
        gate: its name, "R3".
        title: the mechanism.
        required: what must be shown.
        reached: what was shown, or why the gate could not run.
        passed: whether it suffices.
        numbers: everything measured, JSON-compatible.
        seconds: that the gate took.
        reports: of the diagnoses that were completed, by name.
        curves: for plots.
        error: what ended the gate; None if it ran.
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
    error: Exception | None = None

    @classmethod
    def of(
        cls,
        gate: Titled,
        outcome: Outcome,
        begun: float,
        reports: Mapping[str, Report],
        error: Exception | None,
        curves: Sequence[Curve] = (),
    ) -> "GateResult":
        """Of a gate that began at a time of `time.perf_counter`, s."""
        seconds = round(time.perf_counter() - begun, 1)
        told = gate.name, gate.title, gate.required, outcome.reached, outcome.passed, outcome.numbers
        return cls(*told, seconds, reports, curves, error)

    def to_dict(self) -> dict[str, Any]:
        """JSON-compatible, without the curves."""
        names = ("gate", "title", "required", "reached", "passed", "numbers", "seconds")
        return {name: getattr(self, name) for name in names} | {
            "reports": {name: report.to_dict() for name, report in self.reports.items()}
        }
