"""Values of an image between its pixels."""

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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


def connected(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], int]:
    """Connected parts of a mask: [h, w] with 1 to n in them and 0 elsewhere, and n."""
    labels, number = cast(tuple[NDArray[np.intp], int], ndimage.label(mask))
    return labels, int(number)


def grown(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """A mask and its neighbours up to a number of steps along rows and columns."""
    return cast(NDArray[np.bool_], ndimage.binary_dilation(mask, iterations=steps))


def depth(mask: NDArray[np.bool_]) -> Array:
    """Distance of each pixel of a mask from the nearest one outside it, [h, w], pixels."""
    return cast(Array, ndimage.distance_transform_edt(np.pad(mask, 1)))[1:-1, 1:-1]
