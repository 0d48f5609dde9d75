"""Values of an image between its pixels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def bilinear(image: NDArray[Any], points: Array, fill: float = np.nan) -> Array:
    """Values of an image at points between its pixels.

    Args:
        image: [h, w].
        points: [..., 2], column and row.
        fill: value of points outside the image.

    Returns:
        [...], linear between the four pixels around each point.
    """
    height, width = image.shape
    x, y = points[..., 0], points[..., 1]
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    left = np.minimum(x.astype(np.int64), width - 2)
    top = np.minimum(y.astype(np.int64), height - 2)
    u, v = x - left, y - top
    flat, at = image.reshape(-1), top * width + left
    above = flat[at] * (1 - u) + flat[at + 1] * u
    below = flat[at + width] * (1 - u) + flat[at + width + 1] * u
    return np.where(inside, above * (1 - v) + below * v, fill)


def grid(height: int, width: int) -> Array:
    """Column and row of each pixel, [height, width, 2]."""
    return np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)
