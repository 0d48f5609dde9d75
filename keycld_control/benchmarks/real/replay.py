"""Long rollouts of what a diagnosis says, on recordings that it has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks import refitting
from keycld_control.benchmarks.real.gate import Curve
from keycld_control.benchmarks.refitting import JointPositions, Simulator, Variant
from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import Report

Array = NDArray[np.float64]
SIGMA = 3e-3
"""Standard deviation that residuals of long rollouts are weighted with, rad or m: of models, not of sensors."""


@dataclass(frozen=True)
class HeldOutRollouts:
    """W rollouts of n samples, each from initial states fitted to all of them.

    Attributes:
        recording: `[W]` index of the recording.
        time: `[W, n]` s; NaN after the end of a rollout that is shorter than others.
        measured: `[W, n, nv]` positions, rad or m.
        predicted: `[W, n, nv]` positions.
    """

    recording: NDArray[np.int64]
    time: Array
    measured: Array
    predicted: Array

    def error(self, recording: int | None = None) -> float:
        """Root mean square error of all rollouts, or of those on one recording, mrad or mm."""
        rows = self.recording == recording if recording is not None else np.ones(len(self.recording), bool)
        return 1e3 * float(np.sqrt(np.nanmean((self.measured - self.predicted)[rows] ** 2)))


@dataclass(frozen=True)
class Observed:
    """A simulator, and what is measured of its motion."""

    simulator: Simulator
    observation: JointPositions

    @classmethod
    def of(cls, report: Report, model: mujoco.MjModel) -> "Observed":
        """With the integration step and the errors of sensors that a diagnosis chose."""
        own = report.details["step_s"] == model.opt.timestep
        noise = np.full(model.nv, SIGMA)
        observation = JointPositions(model, noise, tracked=bool(report.details["tracked"]))
        return cls(Simulator(model, None if own else float(report.details["step_s"])), observation)


def variant(report: Report, observed: Observed, *, findings: bool) -> Variant:
    """The simulator with the nuisances of the report, and with or without its effects."""
    values = [
        float(np.log(value)) if nuisance.factor else value
        for nuisance in (*observed.simulator.nuisances, *observed.observation.nuisances)
        for value in [report.nuisance[nuisance.name].value]
    ]
    return Variant(np.array(values), report.evidence.effects if findings and report.evidence is not None else ())


def roll(observed: Observed, simulated: Variant, recordings: Sequence[Recording], seconds: float) -> HeldOutRollouts:
    """Rollouts that follow recordings.

    Args:
        observed: simulator and sensors.
        simulated: its nuisances and effects.
        recordings: to be followed.
        seconds: of each rollout, at most; a recording that is shorter is one rollout.
    """
    parts = []
    for index, recording in enumerate(map(refitting.thin, recordings)):
        samples = min(len(np.asarray(recording.t_state)), _samples(recording, seconds))
        problem = refitting.windowed(observed.simulator, [recording], observed.observation, samples)
        predicted = refitting.predicted(refitting.refit_states(problem, simulated, 15))
        for w in range(len(problem.windows)):
            parts.append((index, problem.windows.time[w], problem.windows.measured[w], predicted[w]))
    longest = max(len(time) for _, time, _, _ in parts)
    columns = [[_padded(part[k], longest) for part in parts] for k in (1, 2, 3)]
    return HeldOutRollouts(np.array([part[0] for part in parts]), *(np.stack(c) for c in columns))


def refit(observed: Observed, effects: Sequence[Effect], recordings: Sequence[Recording], seconds: float) -> Variant:
    """Nuisances and given effects fitted to long rollouts, for comparison with what a diagnosis found."""
    thinned = [refitting.thin(r) for r in recordings]
    samples = min(min(len(np.asarray(r.t_state)) for r in thinned), _samples(thinned[0], seconds))
    problem = refitting.windowed(observed.simulator, thinned, observed.observation, samples)
    return refitting.refit(problem, effects, 25).point.variant


def curves(report: Report, model: mujoco.MjModel, recordings: Sequence[Recording], seconds: float) -> list[Curve]:
    """The first rollout of each recording and joint, measured, refitted, corrected."""
    observed = Observed.of(report, model)
    rollouts = {
        name: roll(observed, variant(report, observed, findings=added), recordings, seconds)
        for name, added in (("refitted", False), ("corrected", True))
    }
    out, first = [], rollouts["refitted"]
    for r, recording in enumerate(recordings):
        rows = np.flatnonzero(first.recording == r)
        for j, joint in enumerate(recording.joint_names if len(rows) else ()):
            w = rows[0]
            predicted = {name: part.predicted[w, :, j] for name, part in rollouts.items()}
            out.append(Curve(f"{recording.id}, {joint}", "rad", first.time[w], first.measured[w, :, j], predicted))
    return out


def _samples(recording: Recording, seconds: float) -> int:
    return int(seconds / float(np.median(np.diff(np.asarray(recording.t_state))))) + 1


def _padded(array: Array, length: int) -> Array:
    """With NaN at the end."""
    return np.concatenate([array, np.full((length - len(array), *array.shape[1:]), np.nan)])
