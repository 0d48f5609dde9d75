"""Fits tried on recordings that they have not seen."""

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.fit import Fit, Point, Problem
from keycld_model.diagnosis.estimation.pulses import with_pulses
from keycld_model.diagnosis.simulation.simulator import Pulse


def replay(problem: Problem, fit: Fit, iterations: int = 8, pulses: tuple[Pulse, ...] = ()) -> Fit:
    """The numbers of a fit on other recordings; only their starts, and pulses if it has any, are fitted.

    Where `pulses` of these recordings are given, they are taken as they are.
    """
    start = Point(replace(fit.point.variant.elsewhere(), pulses=pulses), *problem.windows.initial_states())
    if fit.point.variant.jumps is not None:
        start = start.loosened()
    tried = problem.minimise(start, iterations, only_states=True)
    joints = sorted({pulse.dof for pulse in fit.point.variant.pulses})
    return with_pulses(tried, joints, only_states=True) if joints and not pulses else tried


def likelihood(fit: Fit) -> float:
    """Nats, without the prior."""
    return 0.5 * float(np.sum((fit.point.variant.values / fit.problem.spreads) ** 2)) - fit.cost


def _residual(fit: Fit) -> NDArray[np.float64]:
    """Whitened, `[W, n, nv]`."""
    return fit.problem.residual(fit.point).reshape(fit.problem.windows.measured.shape)


def rollout_error(fit: Fit) -> float:
    """Root mean square, rad or m."""
    squares = (_residual(fit) * fit.problem.noise) ** 2
    return float(np.sqrt(squares.sum() / np.isfinite(fit.problem.windows.measured).sum()))


def error_unit(model: mujoco.MjModel) -> str:
    """Of a thousandth of it."""
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    return "mrad" if hinges.all() else "mrad or mm" if hinges.any() else "mm"


def mean_square(fit: Fit) -> NDArray[np.float64]:
    """Of whitened residuals, per joint, `[nv]`, per degree of freedom."""
    measured = fit.problem.windows.measured
    squares, counts = np.sum(_residual(fit) ** 2, axis=(0, 1)), np.isfinite(measured).sum(axis=(0, 1))
    return squares / counts / (1 - 2 / measured.shape[1])
