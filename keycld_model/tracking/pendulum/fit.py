"""A motion fitted to measured angles by Levenberg-Marquardt."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_model.tracking.pendulum.motion import COMMON, Motion

Array = NDArray[np.float64]
ITERATIONS = 40
FASTER = 2.0
"""The logarithm of the squared frequency changes by no more from where a fit starts: a factor of 2.7 in the period."""
SAMPLES = 700
"""Angles that are fitted; of more, means of neighbours are taken."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The best parameters of a motion.

    Attributes:
        motion: that was fitted.
        parameters: [size].
        covariance: [size, size], with as many independent angles as the residuals' correlation leaves.
        rms: rad, of the residuals.
        origin: time at which the motion starts, s.
    """

    motion: Motion
    parameters: Array
    covariance: Array
    rms: float
    origin: float

    def angles(self, times: Array) -> Array:
        """Angles at times, rad; NaN before the origin."""
        return self._paths(self.parameters[None], times)[0]

    def draws(self, times: Array, number: int, rng: np.random.Generator) -> Array:
        """Angles of motions drawn from the uncertainty of the parameters, [number, T]."""
        draws = rng.multivariate_normal(self.parameters, self.covariance, number, method="eigh")
        draws[:, COMMON:] = np.maximum(draws[:, COMMON:], 0)
        return self._paths(draws, times)

    def _paths(self, parameters: Array, times: Array) -> Array:
        out, after = np.full((len(parameters), len(times)), np.nan), times >= self.origin
        out[:, after] = self.motion.simulate(parameters, np.concatenate([[self.origin], times[after]]))[:, 1:]
        return out


def fit_motion(motion: Motion, times: Array, angles: Array, start: Array) -> Fit:
    """Least squares over the whole stretch.

    Args:
        motion: which dissipation.
        times: [T], s.
        angles: [T], rad.
        start: [size], parameters to start from.
    """
    clock = np.concatenate([[times[0]], times])
    p, damping = start.copy(), 1e-3

    def residual(parameters: Array) -> Array:
        return motion.simulate(parameters, clock)[:, 1:] - angles

    steps = np.array([1e-5, 1e-5, 1e-5, 1e-5, *[1e-5] * len(motion.terms)])
    error = residual(p[None])[0]
    jacobian = np.zeros((len(times), motion.size))
    for _ in range(ITERATIONS):
        jacobian = ((residual(p + np.diag(steps)) - error) / steps[:, None]).T
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ error
        moved = False
        for _ in range(8):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -gradient)
            trial = p + step
            trial[COMMON:] = np.maximum(trial[COMMON:], 0)
            if not np.isfinite(trial).all() or abs(trial[0] - start[0]) > FASTER:
                damping *= 4
                continue
            new = residual(trial[None])[0]
            if np.isfinite(new).all() and new @ new < error @ error:
                moved = (error @ error - new @ new) > 1e-7 * (error @ error)
                p, error, damping = trial, new, max(damping / 5, 1e-9)
                break
            damping *= 4
        if not moved:
            break
    # of neighbours that err alike only every n-th counts
    independent = max(10.0, len(error) / _correlation(error))
    variance = float(error @ error) / max(1.0, independent - motion.size) * independent / len(error)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance * len(error) / independent
    return Fit(motion, p, (covariance + covariance.T) / 2, float(np.sqrt(np.mean(error**2))), float(times[0]))


def thinned(times: Array, angles: Array, number: int = SAMPLES) -> tuple[Array, Array]:
    """Means of so many neighbours that at most `number` are left; angles that are missing are left out."""
    known = np.isfinite(angles)
    times, angles = times[known], angles[known]
    group = max(1, -(-len(times) // number))
    if group == 1:
        return times, angles
    count = len(times) // group * group
    return times[:count].reshape(-1, group).mean(axis=1), angles[:count].reshape(-1, group).mean(axis=1)


def _correlation(error: Array) -> float:
    """Number of neighbouring residuals that count as one (integrated autocorrelation time)."""
    error = error - error.mean()
    n = len(error)
    spectrum = np.abs(np.fft.rfft(error, 2 * n)) ** 2
    correlation = np.fft.irfft(spectrum)[:n]
    correlation /= max(correlation[0], 1e-30)
    positive = np.flatnonzero(correlation <= 0)
    end = int(positive[0]) if len(positive) else n
    return max(1.0, 1 + 2 * float(correlation[1:end].sum()))
