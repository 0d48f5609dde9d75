"""The noise of measured positions, from how they scatter around smooth curves."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError

Array = NDArray[np.float64]
SAMPLES, DEGREE = 13, 6
"""Samples of a polynomial, and its degree."""
FINEST = 1e-6
"""No sensor is better than this, rad or m."""


def estimate_noise(
    times: Sequence[Array], measured: Sequence[Array], weights: Sequence[Array | None] | None = None
) -> Array:
    """Standard deviation of the noise of every channel, `[m]`.

    Polynomials of degree 6 are fitted to 13 samples at a time, in overlapping pieces; the lower quartile of what is
    left counts, so that shocks and stick-slip do not. Of 3,200 samples, the variance comes out within 4.5 % (one
    standard deviation). Positions on a grid, such as an encoder's, have no less than rounding to it makes.

    Args:
        times: of each recording, `[N]` s.
        measured: of each recording, `[N, m]`; NaN where missing.
        weights: of each recording, `[N, m]` by how much less noise samples have than those whose noise is asked for.

    Raises:
        InputError: if a channel has too few samples for that.
    """
    alike = [None] * len(times) if weights is None else weights
    known = [np.ones(y.shape) if w is None else w for y, w in zip(measured, alike, strict=True)]
    tracks = list(zip(times, measured, known, strict=True))
    channels = range(measured[0].shape[1])
    return np.array([_of_channel([_there(t, y[:, j], w[:, j]) for t, y, w in tracks], j) for j in channels])


def _there(t: Array, y: Array, w: Array) -> tuple[Array, Array, Array]:
    """Times, values and weights of the samples that are there."""
    good = np.isfinite(y)
    return t[good], y[good], w[good]


def _of_channel(tracks: Sequence[tuple[Array, Array, Array]], channel: int) -> float:
    pieces = []
    for t, q, weight in tracks:
        for i in range(0, len(t) - SAMPLES + 1, 3):
            x, w = t[i : i + SAMPLES], weight[i : i + SAMPLES]
            if x[-1] > x[0]:
                basis = np.polynomial.legendre.legvander(2 * (x - x[0]) / (x[-1] - x[0]) - 1, DEGREE) * w[:, None]
                y = q[i : i + SAMPLES] * w
                left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
                pieces.append(left @ left / (SAMPLES - DEGREE - 1))
    if not pieces:
        raise InputError(f"Joint {channel} has no {SAMPLES} samples in any recording that tell its noise; record more.")
    quartile = np.quantile(pieces, 0.25) / 0.5758  # of chi-square with 6 degrees of freedom, per degree
    return max(float(np.sqrt(quartile)), _grid([q for _, q, _ in tracks]) / np.sqrt(12), FINEST)


def _grid(tracks: Sequence[Array]) -> float:
    """Distance of the points of a grid that nearly all positions lie on, 0 if there is none.

    There is one if, of more than 20 moves over fewer than 20 of its points, 98 % are within 5 % of a whole number.
    """
    moves = np.abs(np.concatenate([np.diff(q) for q in tracks]))
    moves = moves[moves > FINEST]
    if not len(moves):
        return 0.0
    grid = float(moves.min())
    grid = float(np.mean(moves[moves < 1.5 * grid]))  # of many, rounding is less
    near = moves[moves < 20 * grid] / grid
    on = np.abs(near - near.round()) < 0.05
    return grid if len(near) > 20 and on.mean() > 0.98 else 0.0
