"""Over how many samples errors are alike."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SMALL = 0.05
"""Autocorrelation that is none."""


def samples_together(covariance: Callable[[int], Array | np.floating], longest: int) -> Array:
    """How many samples tell no more than a single one, as errors are correlated; one if they are not.

    1 + 2 (sum of the autocorrelations), up to the first that is small.

    Args:
        covariance: of errors so many samples apart, of each of some channels.
        longest: most samples apart that are looked at, exclusive.
    """
    variance = np.maximum(covariance(0), 1e-30)
    out, goes_on = np.ones(np.shape(variance)), np.ones(np.shape(variance), bool)
    for lag in range(1, longest):
        rho = covariance(lag) / variance
        goes_on = goes_on & (rho >= SMALL)
        if not goes_on.any():
            break
        out = out + np.where(goes_on, 2 * rho, 0.0)
    return out
