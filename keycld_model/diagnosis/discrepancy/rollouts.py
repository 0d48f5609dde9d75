"""What both reports say of rollouts over windows of a motion: how they are fitted, their errors, and what is left."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.discrepancy.covariance import Discrepancy
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.replay import rollout_error
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.report import FitErrors, Unexplained

Rows = NDArray[np.int64]
MODEL_ERROR = 3e-3
"""What simulators of real mechanisms err by over a window, rad or m; only the weight of outliers depends on it."""
MOST = 120
"""Windows of a fit at most."""


def rollouts(motion: Motion, simulator: Simulator) -> Problem:
    """The windows of a motion for a simulator that errs."""
    noise = np.maximum(motion.noise, MODEL_ERROR)
    observation = JointPositions(simulator.model, noise, criteria=simulator.criteria)
    return Problem(simulator, replace(motion.windows, observation=observation))


def enough(rows: Rows) -> Rows:
    """As many rows as a fit needs, spread evenly."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST)).round().astype(int)]


def error_over(fits: Sequence[Fit]) -> float:
    """Root mean square error over the samples of all fits, in the units of the channels."""
    samples = [fit.problem.samples for fit in fits]
    squares = [rollout_error(fit) ** 2 * n for fit, n in zip(fits, samples, strict=True)]
    return float(np.sqrt(sum(squares) / sum(samples)))


def fit_errors(problem: Problem, tested_on: str, errors: Sequence[float]) -> FitErrors:
    """Errors of the simulator as it was, refitted, and corrected.

    Args:
        problem: windows of the rollouts.
        tested_on: what the errors are on, a phrase.
        errors: in the units of the channels.
    """
    time = problem.windows.time
    seconds = float(np.median(time[:, -1] - time[:, 0]))
    metric = f"root mean square of rollouts over {seconds:.2g} s with fitted initial states, {tested_on}"
    return FitErrors.of(metric, problem.windows.observation.units, errors)


def unexplained(motion: Motion, discrepancy: Discrepancy, errors: FitErrors, sentence: str) -> Unexplained:
    """What is left, and the joint at which unknown forces are largest for its inertia.

    Args:
        motion: along which they are.
        discrepancy: their sizes.
        errors: of rollouts.
        sentence: the message, with {} for the sizes in words.
    """
    model = motion.model
    length = float(np.median(motion.windows.end - motion.windows.start)) / motion.response.shape[-1]
    names = [model.joint(int(model.dof_jntid[dof])).name for dof in range(model.nv)]
    sizes = ", ".join(f"{size:.2g} at {name}" for name, size in zip(names, discrepancy.force, strict=True))
    worst = int(np.argmax(discrepancy.force / np.maximum(model.dof_M0, 1e-9)))
    fraction = float(np.clip((errors.corrected / max(errors.refitted, 1e-12)) ** 2, 0, 1))
    message = sentence.format(f"{sizes} (N m or N, root mean square over {1e3 * length:.0f} ms)")
    return Unexplained(True, round(fraction, 4), names[worst], message)
