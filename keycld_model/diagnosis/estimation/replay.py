"""Fits tried on recordings that they have not seen."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import learned, minimise
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.pulses import with_pulses
from keycld_model.diagnosis.simulation.variant import Pulse


def replay(problem: Problem, fit: Fit, iterations: int = 8, pulses: tuple[Pulse, ...] = ()) -> Fit:
    """The parameters of a fit on other recordings; only their starts, and pulses if it has any, are fitted.

    Where `pulses` of these recordings are given, they are taken as they are.
    """
    start = Point(fit.point.variant.for_other_recordings(), *problem.windows.initial_states()).with_pulses(*pulses)
    if fit.point.variant.window_offsets is not None:
        start = start.with_free_rotors()
    tried = minimise(problem, start, iterations, only_states=True)
    joints = sorted({pulse.dof for pulse in fit.point.variant.pulses})
    return with_pulses(tried, joints, only_states=True) if joints and not pulses else tried


def predict(problem: Problem, fit: Fit) -> Fit:
    """A fit on other recordings, nuisances and parameters of effects free as far as its own recordings leave them."""
    return freed(replay(problem, fit), fit)


def freed(replayed: Fit, fit: Fit) -> Fit:
    """A fit that was replayed on other recordings, nuisances and parameters free as far as its own leave them."""
    return minimise(replace(replayed.problem, belief=learned(fit)), replayed.point)


def predicted(fit: Fit) -> float:
    """Logarithm of the probability of recordings by what others tell, see `predict`, nats up to a constant."""
    belief = fit.problem.belief
    assert belief is not None
    return belief.narrowed(fit.hessian) - fit.cost


def rollout_error(fit: Fit) -> float:
    """Root mean square error, in the units of the channels."""
    squares = (fit.residual / fit.problem.inverse_noise) ** 2
    return float(np.sqrt(squares.sum() / np.isfinite(fit.problem.windows.measured).sum()))


def error_unit(units: tuple[str, ...]) -> str:
    """Unit of a thousandth of an error of channels with these units."""
    return " or ".join(f"m{unit}" for unit in sorted(set(units), reverse=True))


def mean_square(fit: Fit) -> NDArray[np.float64]:
    """Mean square of whitened residuals per degree of freedom, by channel, `[m]`."""
    measured, nv = fit.problem.windows.measured, fit.point.q.shape[1]
    squares, counts = np.sum(fit.residual**2, axis=(0, 1)), np.isfinite(measured).sum(axis=(0, 1))
    return squares / counts / (1 - 2 * nv / (measured.shape[1] * measured.shape[2]))
