"""Corrected simulators against what the owners identified: rollouts over recordings that neither was fitted to."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.owners.model import OwnersModel
from keycld_control.benchmarks.real.replay import SIGMA, HeldOutRollouts, Observed, roll, variant
from keycld_control.benchmarks.refitting import JointPositions, Simulator, Variant, accurate_step
from keycld_model.diagnosis import Report, diagnose

HORIZONS = (0.2, 0.5, 1.0)
"""s."""
DRAWN = 1000
"""Bootstrap samples."""


@dataclass(frozen=True)
class OwnersRig:
    """A mechanism that its owners identified.

    Attributes:
        name: of it.
        training: files to diagnose.
        held_out: files to compare on.
        owners: makes all that they published of it, of the folder with the data sets. One of them is compared with;
            without its friction, it is the simulator that is diagnosed.
        model: the one that is compared with; if None, what does best on the training recordings.
        tested: the diagnosis is given the held-out recordings, too, to test its findings on.
    """

    name: str
    training: Sequence[RecordingFile]
    held_out: Sequence[RecordingFile]
    owners: Callable[[Path], Sequence[OwnersModel]]
    model: str | None = None
    tested: bool = False


@dataclass(frozen=True)
class Compared:
    """Root mean square errors of rollouts, mrad or mm.

    Attributes:
        seconds: of a rollout.
        owners: of the owners' model.
        corrected: of the corrected simulator.
        low: 5th percentile of the ratio of both, corrected over owners.
        high: 95th.
        rollouts: how many.
        recordings: that they are of.
    """

    seconds: float
    owners: float
    corrected: float
    low: float
    high: float
    rollouts: int
    recordings: int

    @property
    def ratio(self) -> float:
        """Corrected over owners."""
        return self.corrected / self.owners


@dataclass(frozen=True)
class Versus:
    """One rig.

    Attributes:
        name: of the rig.
        model: of the owners, its name.
        report: of the diagnosis.
        compared: by horizon.
        seconds: that the diagnosis took.
    """

    name: str
    model: str
    report: Report
    compared: tuple[Compared, ...]
    seconds: float


def versus(rig: OwnersRig, folder: Path) -> Versus:
    """Diagnose the training recordings, and compare on the others.

    Raises:
        InputError: if a file is missing or damaged.
    """
    training, held_out = ([file.recording(folder) for file in files] for files in (rig.training, rig.held_out))
    step = accurate_step(training)
    published = {model.name: (_as_published(model, step), model.simulator) for model in rig.owners(folder)}
    errors = {name: roll(*simulated, training, HORIZONS[1]).error() for name, (simulated, _) in published.items()}
    best = rig.model or min(errors, key=lambda name: np.nan_to_num(errors[name], nan=np.inf))
    theirs, simulator = published[best]
    start = time.perf_counter()
    report = diagnose(training, simulator, held_out if rig.tested else ())
    seconds = round(time.perf_counter() - start, 1)
    own = Observed.of(report, simulator)
    ours = own, variant(report, own, findings=True)
    compared = tuple(compare(roll(*theirs, held_out, s), roll(*ours, held_out, s), s) for s in HORIZONS)
    return Versus(rig.name, best, report, compared, seconds)


def _as_published(model: OwnersModel, step: float) -> tuple[Observed, Variant]:
    """Without anything refitted."""
    simulator = Simulator(model.simulator, step)
    rig = Observed(simulator, JointPositions(model.simulator, np.full(model.simulator.nv, SIGMA)))
    return rig, Variant(np.zeros(len(simulator.nuisances) + len(rig.observation.nuisances)), model.effects)


def compare(theirs: HeldOutRollouts, ours: HeldOutRollouts, seconds: float) -> Compared:
    """Errors of the same rollouts, and an interval of their ratio.

    Recordings are drawn with replacement, and then rollouts of each.
    """
    squares = [np.nansum((r.measured - r.predicted) ** 2, axis=(1, 2)) for r in (theirs, ours)]
    count = np.isfinite(theirs.measured).sum(axis=(1, 2))
    groups = [np.flatnonzero(theirs.recording == r) for r in np.unique(theirs.recording)]
    rng, ratios = np.random.default_rng(0), []
    for _ in range(DRAWN):
        drawn = [groups[g] for g in rng.integers(len(groups), size=len(groups))]
        rows = np.concatenate([rng.choice(own, len(own)) for own in drawn])
        ratios.append(np.sqrt(squares[1][rows].sum() / squares[0][rows].sum()))
    theirs_error, ours_error = (1e3 * float(np.sqrt(s.sum() / count.sum())) for s in squares)
    low, high = np.percentile(ratios, [5, 95])
    return Compared(seconds, theirs_error, ours_error, float(low), float(high), len(count), len(groups))
