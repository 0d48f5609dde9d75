"""Simulators refitted to recordings with the estimator of the diagnosis, for what the diagnosis is compared with.

All that benchmarks take from inside the diagnosis comes through here, except what the greedy baseline borrows of its
search.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.motion import inverse_dynamics
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs import checks, prepare
from keycld_model.diagnosis.inputs.checks import check_apart
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.prepare import accurate_step, spacing, thin
from keycld_model.diagnosis.inputs.windows import average_commands, cut
from keycld_model.diagnosis.search.effort import EFFORT
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant
from keycld_model.diagnosis.verdict.report import Finding

Array = NDArray[np.float64]
SAMPLES, HORIZON = STANDARD.sizes.window, STANDARD.sizes.rollout
"""Samples of a window of the diagnosis, and windows that its long rollouts are as long as."""


def check(recordings: Sequence[Recording], model: mujoco.MjModel) -> None:
    """Raise InputError if recordings do not suit a model, as the diagnosis does."""
    checks.check(recordings, model, JointPositions(model), SAMPLES)


def split(recordings: Sequence[Recording], model: mujoco.MjModel) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings, as the diagnosis parts them."""
    return prepare.split(recordings, JointPositions(model), SAMPLES)


def windowed(
    simulator: Simulator, recordings: Sequence[Recording], observation: JointPositions, samples: int = SAMPLES
) -> Problem:
    """Recordings cut into windows, to be explained by a simulator.

    Args:
        simulator: of the mechanism.
        recordings: sampled as fast as they are; the diagnosis uses no more than about 100 samples a second.
        observation: joint positions, with their noise.
        samples: of a window.
    """
    return Problem(simulator, cut([thin(r) for r in recordings], observation, simulator.step, samples))


def at_most(problem: Problem, windows: int = EFFORT.windows) -> Problem:
    """A problem with no more than a number of its windows, evenly chosen."""
    return problem.take(problem.windows.evenly(windows))


def refit(problem: Problem, effects: Sequence[Effect] = (), iterations: int = 15) -> Fit:
    """Nuisances, parameters of effects, and initial states, fitted."""
    return minimise(problem, problem.start().with_effects(*effects), iterations)


def refit_states(problem: Problem, variant: Variant, iterations: int) -> Fit:
    """Initial states fitted, with nuisances and effects as they are."""
    return minimise(problem, Point(variant, *problem.windows.initial_states()), iterations, only_states=True)


def predicted(fit: Fit) -> Array:
    """Measured positions as a fit predicts them, `[W, n, nv]`."""
    return fit.problem.predicted(fit.point)


__all__ = [
    "HORIZON",
    "SAMPLES",
    "Finding",
    "Fit",
    "JointPositions",
    "Problem",
    "Simulator",
    "Variant",
    "accurate_step",
    "at_most",
    "average_commands",
    "check",
    "check_apart",
    "inverse_dynamics",
    "minimise",
    "predicted",
    "refit",
    "refit_states",
    "spacing",
    "split",
    "thin",
    "windowed",
]
