"""What a diagnosis rests on, for people to look at: models, rollouts and residuals."""

from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect, edited
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.verdict.region import Shape, shape_of
from keycld_model.rigid_body.residual_force import ResidualForce

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rollout:
    """A held-out recording, and what simulators make of it.

    Attributes:
        recording: its id.
        time: `[n]` s.
        measured: `[n, m]` what the sensor showed; NaN where missing.
        refitted: `[n, m]` of the simulator with nuisances refitted.
        corrected: `[n, m]` with the findings added.
        poses: `[3, n, nv]` joint positions of these three, rad or m, as far as the channels tell them.
        starts: `[k]` indices of samples at which rollouts begin, with initial states fitted.
        baseline: it is of the baseline, which nothing is added to.
    """

    recording: str
    time: Array
    measured: Array
    refitted: Array
    corrected: Array
    poses: Array
    starts: NDArray[np.int64]
    baseline: bool = False


@dataclass(frozen=True)
class Residuals:
    """What fits leave of a training recording.

    Attributes:
        recording: its id.
        time: `[n]` s.
        before: `[n, m]` measured minus refitted simulator over the sensor's noise; NaN where missing.
        after: `[n, m]` the same with the findings added.
        starts: `[k]` indices of samples at which windows begin, with initial states fitted.
        baseline: it is of the baseline, which nothing is added to.
    """

    recording: str
    time: Array
    before: Array
    after: Array
    starts: NDArray[np.int64]
    baseline: bool = False


@dataclass(frozen=True)
class Picture:
    """A frame of a held-out recording, and where simulators have the links.

    Attributes:
        recording: its id.
        time: s.
        frame: `[H, W, 3]`.
        links: `[3, L, 2, 2]` columns and rows of both ends of every link, pixels, NaN where not known: as seen, of the
            refitted simulator, and of the corrected one.
    """

    recording: str
    time: float
    frame: NDArray[np.uint8]
    links: Array


@dataclass(frozen=True)
class Evidence:
    """What the page and the corrected model are made of.

    Attributes:
        nominal: the simulator as it was.
        refitted: with the nuisances of the final fit, its integrator and its time step, without effects.
        effects: that were added.
        channels: names of what was measured.
        units: of these.
        noise: `[m]` standard deviation that residuals are over: of the sensor's noise.
        of_sensors: it is; otherwise it is the error that is expected of a model.
        rollouts: one per held-out recording.
        residuals: one per training recording.
        shape: of the residual force, if there is one.
    """

    nominal: mujoco.MjModel
    refitted: mujoco.MjModel
    effects: tuple[Effect, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    noise: Array
    rollouts: tuple[Rollout, ...]
    residuals: tuple[Residuals, ...]
    shape: Shape | None = None
    of_sensors: bool = True
    pictures: tuple[Picture, ...] = ()

    @cached_property
    def corrected(self) -> mujoco.MjModel:
        """The refitted model with those effects that are in its numbers."""
        return edited(self.refitted, self.effects)


def evidence(
    nominal: mujoco.MjModel,
    windows: tuple[Fit, Fit],
    rollouts: tuple[Fit, Fit],
    of_sensors: bool = True,
    baseline: Fit | None = None,
) -> Evidence:
    """Gather it from fits.

    Args:
        nominal: the simulator as it was.
        windows: refitted and corrected, of training recordings.
        rollouts: refitted and corrected, of held-out recordings.
        of_sensors: residuals are over the noise of sensors, not over the error that is expected of a model.
        baseline: refitted, of recordings that others are compared with.
    """
    before = [] if baseline is None else [(baseline, baseline)]
    chosen = windows[1]
    seen = chosen.problem.windows.observation
    simulator, bare = chosen.problem.simulator, replace(chosen.point.variant, effects=())
    return Evidence(
        nominal=nominal,
        refitted=simulator.compile(bare),
        effects=chosen.effects,
        channels=seen.names,
        units=seen.units,
        noise=seen.noise,
        rollouts=(*_rollouts(rollouts), *(replace(r, baseline=True) for fits in before for r in _rollouts(fits))),
        residuals=(*_residuals(windows), *(replace(r, baseline=True) for fits in before for r in _residuals(fits))),
        shape=next((shape_of(chosen, e) for e in chosen.effects if isinstance(e, ResidualForce)), None),
        of_sensors=of_sensors,
    )


def _rollouts(fits: tuple[Fit, Fit]) -> list[Rollout]:
    pieces = fits[0].problem.windows
    shown = (pieces.measured, *(fit.problem.predicted(fit.point) for fit in fits))
    out = []
    for r, rows in _by_recording(pieces.recording):
        measured, refitted, corrected = (np.concatenate(channels[rows]) for channels in shown)
        out.append(
            Rollout(
                recording=pieces.ids[r],
                time=pieces.time[rows].ravel(),
                measured=measured,
                refitted=refitted,
                corrected=corrected,
                poses=np.stack([pieces.observation.positions(y) for y in (measured, refitted, corrected)]),
                starts=np.arange(len(rows)) * pieces.time.shape[1],
            )
        )
    return out


def _residuals(fits: tuple[Fit, Fit]) -> list[Residuals]:
    pieces, inverse_noise = fits[0].problem.windows, fits[0].problem.inverse_noise
    before, after = ((pieces.measured - fit.problem.predicted(fit.point)) * inverse_noise for fit in fits)
    return [
        Residuals(
            recording=pieces.ids[r],
            time=pieces.time[rows].ravel(),
            before=np.concatenate(before[rows]),
            after=np.concatenate(after[rows]),
            starts=np.arange(len(rows)) * pieces.time.shape[1],
        )
        for r, rows in _by_recording(pieces.recording)
    ]


def _by_recording(recording: NDArray[np.int64]) -> list[tuple[int, NDArray[np.int64]]]:
    """Indices of recordings, and rows of their windows."""
    return [(int(r), np.flatnonzero(recording == r)) for r in np.unique(recording)]
