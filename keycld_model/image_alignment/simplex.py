"""The least of a function that has steps, near a point: simplex searches (Nelder and Mead, 1965)."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[np.float64]


def least_near(
    of: Callable[[Array], float],
    size: int,
    reaches: Sequence[float],
    evaluations: int,
    exact: float,
    flat: float = 0.0,
) -> tuple[Array, float]:
    """Where a function of `[size]` numbers is least near zero, and that value.

    Args:
        of: the function.
        size: how many numbers.
        reaches: first steps of searches, one after the other, each from the best so far.
        evaluations: of each search, at most.
        exact: a search ends when its points are no farther apart,
        flat: and their values.
    """
    here = np.zeros(size)
    best, least = here, of(here)
    for reach in reaches:
        simplex = best + reach * np.vstack([here, np.eye(size)])
        options = {"maxfev": evaluations, "xatol": exact, "fatol": flat, "initial_simplex": simplex}
        found = minimize(of, best, method="Nelder-Mead", options=options)
        if found.fun < least:
            best, least = found.x, float(found.fun)
    return best, least
