"""Simulators refitted to recordings with the estimator of the diagnosis, for what the diagnosis is compared with.

All that benchmarks take from inside the diagnosis comes through here, except what the greedy baseline borrows of its
search.
"""

from collections.abc import Sequence

import numpy as np
from keycld_model.diagnosis.inputs.noise import noise
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.diagnose import HORIZON, WINDOWS
from keycld_model.diagnosis.estimation.fit import Fit, Point, Problem
from keycld_model.diagnosis.inputs.checks import check, check_apart
from keycld_model.diagnosis.inputs.prepare import SAMPLES, accurate_step, spacing, split, thin
from keycld_model.diagnosis.inputs.windows import average_commands, cut
from keycld_model.diagnosis.simulation.simulator import Simulator, Variant
from keycld_model.diagnosis.verdict.report import Finding

Array = NDArray[np.float64]


def windowed(simulator: Simulator, recordings: Sequence[Recording], sigma: Array, samples: int = SAMPLES) -> Problem:
    """Recordings cut into windows, to be explained by a simulator.

    Args:
        simulator: of the mechanism.
        recordings: sampled as fast as they are; the diagnosis uses no more than about 100 samples a second.
        sigma: `[nv]` standard deviation of the measurement, rad or m.
        samples: of a window.
    """
    return Problem(simulator, cut([thin(r) for r in recordings], simulator.step, samples), sigma)


def at_most(problem: Problem, windows: int = WINDOWS) -> Problem:
    """A problem with no more than a number of its windows, evenly chosen."""
    total = len(problem.windows)
    return problem if total <= windows else problem.take(np.linspace(0, total - 1, windows).round().astype(int))


def refit(problem: Problem, effects: Sequence[Effect] = (), iterations: int = 15) -> Fit:
    """Nuisances, numbers of effects, and initial states, fitted."""
    return problem.minimise(problem.start().with_effects(*effects), iterations)


def refit_states(problem: Problem, variant: Variant, iterations: int) -> Fit:
    """Initial states fitted, with nuisances and effects as they are."""
    return problem.minimise(Point(variant, *problem.windows.initial_states()), iterations, only_states=True)


def predicted(fit: Fit) -> Array:
    """Measured positions as a fit predicts them, `[W, n, nv]`."""
    problem, point = fit.problem, fit.point
    simulate, one = problem.simulator.simulate, np.zeros(1, int)
    return simulate([point.variant], one, problem.windows, point.q[None], point.v[None])[0]


__all__ = [
    "HORIZON",
    "SAMPLES",
    "Finding",
    "Fit",
    "Problem",
    "Simulator",
    "Variant",
    "accurate_step",
    "at_most",
    "average_commands",
    "check",
    "check_apart",
    "noise",
    "predicted",
    "refit",
    "refit_states",
    "spacing",
    "split",
    "thin",
    "windowed",
]
