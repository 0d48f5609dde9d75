"""A plane of motion that is not quite parallel to the picture: its circles are ellipses there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tilt:
    """The symmetric linear map that makes a circle of an ellipse about the pivot.

    Attributes:
        stretch: [2, 2], about the identity, the identity for a plane parallel to the picture.
        ratio: shorter over longer axis of the ellipse.
        deviation: standard deviation of `ratio`.
        off: working pixels, root mean square distance of the keypoint from the ellipse.
        radius: working pixels, of the circle that the ellipse becomes.
    """

    stretch: Array
    ratio: float
    deviation: float
    off: float
    radius: float


def fit_tilt(places: Array, pivot: Array) -> Tilt | None:
    """The ellipse about a known pivot on which a keypoint moves.

    Args:
        places: [n, 2], working pixels.
        pivot: [2].

    Returns:
        None if the points lie on no ellipse about it.
    """
    x, y = (places - pivot).T
    size = float(np.hypot(x, y).mean())
    x, y = x / size, y / size
    design = np.stack([x**2, 2 * x * y, y**2], axis=1)
    weight = np.ones(len(x))
    p, spread = np.zeros(3), 1.0
    for _ in range(5):
        p = np.linalg.lstsq(design * weight[:, None], weight, rcond=None)[0]
        error = design @ p - 1
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-9
        weight = np.clip(1 - (error / (5 * spread)) ** 2, 0, None)
    conic = np.array([[p[0], p[1]], [p[1], p[2]]])
    values, vectors = np.linalg.eigh(conic)
    if values.min() <= 0:
        return None
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    ratio = float(np.sqrt(values.min() / values.max()))
    correlated = 10.0
    covariance = np.linalg.pinv(design.T @ design) * spread**2 * correlated
    deviation = 0.5 * ratio * float(np.sqrt(covariance[0, 0] / p[0] ** 2 + covariance[2, 2] / p[2] ** 2))
    return Tilt(root, ratio, deviation, float(spread / 2 * size), size)
