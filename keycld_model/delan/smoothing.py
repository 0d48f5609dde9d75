"""Velocities and accelerations from measured positions, with their uncertainty.

A joint's position is taken for an integrated random walk, its fourth derivative for white noise, and measurements for
the position with white noise: the posterior mean is a smoothing spline (Wahba, 1978), which a Kalman filter and a
Rauch-Tung-Striebel smoother give in linear time on any clock (Kohn and Ansley, 1987). The ratio of both noises
maximises the likelihood, so that nothing is tuned by hand, and each velocity and acceleration has its own standard
deviation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import factorial

Floats = NDArray[np.float64]
ORDER = 4
"""Derivatives that are followed, the position among them; the next one is white noise."""
VAGUE = 1e5
"""Prior standard deviation of position, velocity and acceleration at the start, in units of the scaled signal."""
SHORTEST = 64
"""Samples to which shorter recordings are padded."""
RANGE = (-30.0, 30.0)
"""Logarithms of the ratio of both noises that are searched, in units of the mean sampling interval."""
EXACT = 1e-10
"""Noise of measurements, as a share of the signal, below which computing in doubles no longer tells."""


@dataclass(frozen=True)
class Smoothed:
    """Positions, velocities and accelerations `[T, n]`, and the standard deviations of the latter two.

    Attributes:
        q: rad or m.
        v: per s.
        a: per s^2.
        v_std: of v.
        a_std: of a.
        noise: `[n]`, standard deviation of measured positions.
    """

    q: Floats
    v: Floats
    a: Floats
    v_std: Floats
    a_std: Floats
    noise: Floats


def smooth(t: Floats, q: Floats) -> Smoothed:
    """Smooth positions `[T, n]` at times `[T]`, s, which increase; T is at least 8.

    Positions may be NaN where a sample is missing.
    """
    columns = [_smooth_one(t, column) for column in q.T]
    mean = np.stack([c[0] for c in columns], axis=1)
    std = np.stack([c[1] for c in columns], axis=1)
    noise = np.array([c[2] for c in columns])
    return Smoothed(mean[..., 0], mean[..., 1], mean[..., 2], std[..., 1], std[..., 2], noise)


def _smooth_one(t: Floats, q: Floats) -> tuple[Floats, Floats, float]:
    """State `[T, ORDER]` of one joint, its standard deviations, and the noise of its positions."""
    good = np.isfinite(q)
    unit, centre = float(np.mean(np.diff(t))), float(np.mean(q[good]))
    size = float(np.std(q[good])) or 1.0
    rest = max(SHORTEST, 1 << (len(t) - 1).bit_length()) - len(t)  # few lengths, so that few programs are compiled
    gaps = np.pad(np.diff(t, prepend=t[0]) / unit, (0, rest))
    y = np.pad(np.where(good, (q - centre) / size, 0.0), (0, rest))
    good = np.pad(good, (0, rest))
    with jax.enable_x64(True):
        best = _least(lambda log_ratio: float(_filter(log_ratio, gaps, y, good)[0]))
        mean, variance, scale = map(np.asarray, _smoother(best, gaps, y, good))
    mean, variance = mean[: len(t)], variance[: len(t)]
    units = size / unit ** np.arange(ORDER)
    std = np.sqrt(np.maximum(np.diagonal(variance, axis1=1, axis2=2) * scale, 0.0)) * units
    mean = mean * units
    mean[:, 0] += centre
    return np.asarray(mean, np.float64), np.asarray(std, np.float64), float(np.sqrt(scale)) * size


def _least(loss: Callable[[float], float]) -> float:
    """Where a loss is least in `RANGE`."""
    found: Any = minimize_scalar(loss, bounds=RANGE, method="bounded")
    return float(found.x)


def _step(gap: Array, ratio: Array) -> tuple[Array, Array]:
    """Transition of a position and its derivatives over a gap, and the variance that enters meanwhile."""
    i, j = np.indices((ORDER, ORDER))
    move = jnp.where(j >= i, gap ** np.maximum(j - i, 0) / factorial(np.maximum(j - i, 0)), 0.0)
    power = 2 * ORDER - 1 - i - j
    return move, ratio * gap**power / (factorial(ORDER - 1 - i) * factorial(ORDER - 1 - j) * power)


@jax.jit
def _filter(log_ratio: Array, gaps: Array, y: Array, good: Array) -> tuple[Array, ...]:
    """Negative log likelihood with the noise's variance maximised out; filtered and predicted means and variances."""
    ratio = jnp.exp(log_ratio)

    def advance(state: tuple[Array, Array], sample: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], tuple]:
        gap, value, measured = sample
        move, noise = _step(gap, ratio)
        mean, variance = move @ state[0], move @ state[1] @ move.T + noise
        predicted = (mean, variance)
        spread = variance[0, 0] + 1.0
        gain = jnp.where(measured, variance[:, 0] / spread, 0.0)
        error = value - mean[0]
        mean = mean + gain * error
        keep = jnp.eye(ORDER).at[:, 0].add(-gain)
        variance = keep @ variance @ keep.T + jnp.outer(gain, gain)
        return (mean, variance), (mean, variance, *predicted, jnp.where(measured, error**2 / spread, 0.0), spread)

    start = (jnp.zeros(ORDER), VAGUE**2 * jnp.eye(ORDER))
    _, (means, variances, before, before_variances, squares, spreads) = jax.lax.scan(advance, start, (gaps, y, good))
    known = jnp.cumsum(good) > ORDER  # the first samples find the start
    number = jnp.sum(good & known)
    scale = jnp.maximum(jnp.sum(jnp.where(known, squares, 0.0)) / number, EXACT**2)
    loss = 0.5 * number * jnp.log(scale) + 0.5 * jnp.sum(jnp.where(good & known, jnp.log(spreads), 0.0))
    return loss, means, variances, before, before_variances, scale


@jax.jit
def _smoother(log_ratio: Array, gaps: Array, y: Array, good: Array) -> tuple[Array, Array, Array]:
    """Posterior means `[T, ORDER]`, variances `[T, ORDER, ORDER]` over the noise's variance, and that variance."""
    _, means, variances, before, before_variances, scale = _filter(log_ratio, gaps, y, good)

    def back(state: tuple[Array, Array], sample: tuple[Array, ...]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        mean, variance, gap, next_mean, next_variance = sample
        move, noise = _step(gap, jnp.exp(log_ratio))
        size = jnp.sqrt(jnp.diagonal(next_variance))
        gain = jnp.linalg.solve(next_variance / jnp.outer(size, size), (move @ variance) / size[:, None])
        gain = (gain / size[:, None]).T
        rest = jnp.eye(ORDER) - gain @ move  # in this form, rounding cannot make variances negative
        spread = rest @ variance @ rest.T + gain @ (state[1] + noise) @ gain.T
        out = mean + gain @ (state[0] - next_mean), spread
        return out, out

    last = means[-1], variances[-1]
    samples = (means[:-1], variances[:-1], gaps[1:], before[1:], before_variances[1:])
    _, (smooth, spread) = jax.lax.scan(back, last, samples, reverse=True)
    return jnp.concatenate([smooth, last[0][None]]), jnp.concatenate([spread, last[1][None]]), scale
