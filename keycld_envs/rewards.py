"""The soft indicator function of dm_control's rewards, as far as the three swing-up tasks use it.

After `dm_control.utils.rewards` (copyright 2017 The dm_control Authors, Apache-2.0), and equal to it to the bit.
"""

from typing import Literal

import numpy as np


def tolerance(
    x: float,
    bounds: tuple[float, float] = (0.0, 0.0),
    margin: float = 0.0,
    sigmoid: Literal["gaussian", "quadratic"] = "gaussian",
    value_at_margin: float = 0.1,
) -> float:
    """1 within the bounds, falling off outside.

    Args:
        x: the quantity to judge.
        bounds: least and greatest value that count as reached, inclusive.
        margin: distance from the bounds at which the result is `value_at_margin`; 0 makes it 0 everywhere outside.
        sigmoid: shape of the fall; "gaussian" never reaches 0, "quadratic" does.
        value_at_margin: between 0 and 1, for "gaussian" greater than 0.
    """
    lower, upper = bounds
    if lower <= x <= upper:
        return 1.0
    if margin == 0:
        return 0.0
    distance = max(lower - x, x - upper) / margin
    if sigmoid == "gaussian":
        return float(np.exp(-0.5 * (distance * np.sqrt(-2 * np.log(value_at_margin))) ** 2))
    return max(0.0, float(1 - (distance * np.sqrt(1 - value_at_margin)) ** 2))
