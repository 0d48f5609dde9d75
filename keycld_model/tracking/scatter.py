"""How noisy a track is: its scatter about smooth motion."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HALF = 3
"""Frames on each side of the one that a local polynomial predicts."""
DEGREE = 3


def scatter(times: Array, values: Array) -> tuple[Array, float]:
    """Differences from a local cubic through the neighbours, as large as the noise of one frame.

    The cubic is fitted to the three frames on each side, without the frame itself; the difference is divided by what
    white noise of size one would give.

    Args:
        times: [T], s.
        values: [T], NaN where missing.

    Returns:
        [T], NaN where it cannot be told, and the robust size: 1.4826 times the median of absolute differences.
    """
    result = np.full(len(values), np.nan)
    sides = np.array([k for k in range(-HALF, HALF + 1) if k])
    for i in range(HALF, len(values) - HALF):
        at = (times[i + sides] - times[i]) / max(times[i + HALF] - times[i - HALF], 1e-12)
        near = values[i + sides]
        if not (np.isfinite(near).all() and np.isfinite(values[i])):
            continue
        weights = np.linalg.pinv(np.vander(at, DEGREE + 1))[-1]
        result[i] = (values[i] - weights @ near) / np.sqrt(1 + weights @ weights)
    known = result[np.isfinite(result)]
    return result, 1.4826 * float(np.median(np.abs(known))) if len(known) else np.nan
