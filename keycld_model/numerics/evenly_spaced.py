"""Some of many, from all over them."""

import numpy as np
from numpy.typing import NDArray


def evenly_spaced(count: int, most: int) -> NDArray[np.int64]:
    """Numbers of at most `most` of `count` things, the first and the last among them."""
    return np.linspace(0, count - 1, min(most, count)).astype(int)
