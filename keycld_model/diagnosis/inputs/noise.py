"""The noise of measured positions, from how they scatter around smooth curves."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording

Array = NDArray[np.float64]

SAMPLES, DEGREE, STRIDE = 13, 6, 3
LEAST = 1e-6
"""No sensor is better than this, rad or m."""
FINE, OFF_GRID, ON_GRID, MANY = 20, 0.05, 0.98, 20
"""Positions are on a grid if of at least so many moves, over fewer points of it than the first, that share are so close
to a whole number of them."""


def noise(recordings: Sequence[Recording]) -> Array:
    """Standard deviation of the noise of every joint, `[nv]`.

    Polynomials of degree 6 are fitted to 13 samples at a time, in overlapping pieces; the lower quartile of what is
    left counts, so that shocks and stick-slip do not. Of 3,200 samples, the variance comes out within 4.5 % (one
    standard deviation). Positions on a grid, such as an encoder's, have no less than rounding to it makes.

    Raises:
        InputError: if a joint has too few samples for that.
    """
    joints = np.asarray(recordings[0].qpos).shape[1]
    return np.array([_of_joint([_track(recording, j) for recording in recordings], j) for j in range(joints)])


def _track(recording: Recording, joint: int) -> tuple[Array, Array]:
    """Times and positions of the samples that are there."""
    t, q = np.asarray(recording.t_state), np.asarray(recording.qpos)[:, joint]
    return t[np.isfinite(q)], q[np.isfinite(q)]


def _of_joint(tracks: Sequence[tuple[Array, Array]], joint: int) -> float:
    pieces = []
    for t, q in tracks:
        for i in range(0, len(t) - SAMPLES + 1, STRIDE):
            x, y = t[i : i + SAMPLES], q[i : i + SAMPLES]
            if x[-1] > x[0]:
                basis = np.polynomial.legendre.legvander(2 * (x - x[0]) / (x[-1] - x[0]) - 1, DEGREE)
                left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
                pieces.append(left @ left / (SAMPLES - DEGREE - 1))
    if not pieces:
        raise InputError(f"Joint {joint} has no {SAMPLES} samples in any recording that tell its noise; record more.")
    quartile = np.quantile(pieces, 0.25) / 0.5758  # of chi-square with 6 degrees of freedom, per degree
    return max(float(np.sqrt(quartile)), _grid([q for _, q in tracks]) / np.sqrt(12), LEAST)


def _grid(tracks: Sequence[Array]) -> float:
    """Distance of the points of a grid that nearly all positions lie on, 0 if there is none."""
    moves = np.abs(np.concatenate([np.diff(q) for q in tracks]))
    moves = moves[moves > LEAST]
    if not len(moves):
        return 0.0
    grid = float(moves.min())
    grid = float(np.mean(moves[moves < 1.5 * grid]))  # of many, rounding is less
    near = moves[moves < FINE * grid] / grid
    on = np.abs(near - near.round()) < OFF_GRID
    return grid if len(near) > MANY and on.mean() > ON_GRID else 0.0
