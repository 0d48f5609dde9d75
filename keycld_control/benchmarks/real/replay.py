"""Long rollouts of what a diagnosis says, on recordings that it has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.real.gate import Curve
from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.estimation.fit import Point, Problem
from keycld_model.diagnosis.inputs.prepare import thin
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.simulation.simulator import Simulator, Variant
from keycld_model.diagnosis.verdict.report import Report

Array = NDArray[np.float64]
SCALE = 3e-3
"""Standard deviation that residuals of long rollouts are weighted with, rad or m: of models, not of sensors."""


@dataclass(frozen=True)
class Rollouts:
    """W rollouts of n samples, each from initial states fitted to all of them.

    Attributes:
        recording: `[W]` index of the recording.
        time: `[W, n]` s.
        measured: `[W, n, nv]`.
        predicted: `[W, n, nv]`.
    """

    recording: NDArray[np.int64]
    time: Array
    measured: Array
    predicted: Array

    def error(self, recording: int | None = None) -> float:
        """Root mean square error, of all or one recording, mrad or mm."""
        rows = self.recording == recording if recording is not None else np.ones(len(self.recording), bool)
        return 1e3 * float(np.sqrt(np.nanmean((self.measured - self.predicted)[rows] ** 2)))


def variant(report: Report, simulator: Simulator, *, findings: bool) -> Variant:
    """The simulator with the nuisances of the correction, with or without its effects."""
    values = [
        float(np.log(value)) if nuisance.factor else value
        for nuisance in simulator.nuisances
        for value in [report.nuisance[nuisance.name].value]
    ]
    return Variant(np.array(values), report.evidence.effects if findings and report.evidence is not None else ())


def roll(simulator: Simulator, which: Variant, recordings: Sequence[Recording], seconds: float) -> Rollouts:
    """Long rollouts.

    Args:
        simulator: steps of it.
        which: its numbers and effects.
        recordings: to be followed.
        seconds: of each rollout, at most; a recording that is shorter is one rollout.
    """
    parts = []
    for index, recording in enumerate(map(thin, recordings)):
        t = np.asarray(recording.t_state)
        samples = min(len(t), int(seconds / float(np.median(np.diff(t)))) + 1)
        problem = Problem(simulator, cut([recording], simulator.step, samples), np.full(simulator.model.nv, SCALE))
        start = Point(which, *problem.windows.initial_states())
        windows, point = problem.windows, problem.minimise(start, 15, only_states=True).point
        predicted = simulator.simulate([which], np.zeros(1, int), windows, point.q[None], point.v[None])[0]
        for w in range(len(windows)):
            parts.append((index, windows.time[w], windows.measured[w], predicted[w]))
    longest = max(len(time) for _, time, _, _ in parts)
    columns = [[_pad(part[k], longest) for part in parts] for k in (1, 2, 3)]
    return Rollouts(np.array([part[0] for part in parts]), *(np.stack(c) for c in columns))


def refit(
    simulator: Simulator, effects: tuple[Effect, ...], recordings: Sequence[Recording], seconds: float
) -> Variant:
    """Nuisances and effects fitted to long rollouts: the opponent of a diagnosis."""
    thinned = [thin(r) for r in recordings]
    samples = min(min(len(np.asarray(r.t_state)) for r in thinned), _samples(thinned[0], seconds))
    problem = Problem(simulator, cut(thinned, simulator.step, samples), np.full(simulator.model.nv, SCALE))
    return problem.minimise(problem.start().with_effects(*effects), 25).point.variant


def simulator_of(report: Report, model: mujoco.MjModel) -> Simulator:
    """The simulator that a diagnosis chose."""
    own = report.details["step_s"] == model.opt.timestep
    return Simulator(model, None if own else report.details["step_s"], tracked=report.details["tracked"])


def curves(report: Report, model: mujoco.MjModel, recordings: Sequence[Recording], seconds: float) -> list[Curve]:
    """The first rollout of each recording and joint, measured, refitted, corrected."""
    simulator = simulator_of(report, model)
    rollouts = {
        name: roll(simulator, variant(report, simulator, findings=added), recordings, seconds)
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


def _pad(array: Array, length: int) -> Array:
    """With NaN at the end."""
    return np.concatenate([array, np.full((length - len(array), *array.shape[1:]), np.nan)])
