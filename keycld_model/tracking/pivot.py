"""The fixed pivot about which a part turns, and its distance to the part's keypoint."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pivot:
    """A circle on which a keypoint moves.

    Attributes:
        centre: [2], working pixels of the reference picture.
        radius: working pixels.
        deviation: [3], standard deviations of centre and radius.
        turning: rad, root mean square by which the part turns otherwise than its place on the circle tells.
        off: working pixels, root mean square distance from the circle.
    """

    centre: Array
    radius: float
    deviation: Array
    turning: float
    off: float


def fit_pivot(
    points: Array, covariance: Array, turns: Array, turn_variance: Array, start: Array, marked: tuple[Array, float]
) -> Pivot:
    """Fit the circle to places and turns of a part together.

    The keypoint stays at one distance of the pivot, and the part turns by as much as the keypoint goes round. Turns
    weigh by what they scatter about that: a bob on a string sways, a rigid rod does not.

    Args:
        points: [T, 2], places of the keypoint.
        covariance: [T, 2, 2].
        turns: [T], rad.
        turn_variance: [T].
        start: [2], near the pivot.
        marked: [2], where somebody marked it, and by how much that may be off, pixels; inf if nobody did.
    """
    sway, scale = 0.05, 1.0

    def parts(p: Array) -> tuple[Array, Array, Array, Array]:
        away = points - p[:2]
        distance = np.linalg.norm(away, axis=1)
        radial = away / distance[:, None]
        tangent = radial[:, ::-1] * [-1, 1]
        along = np.einsum("ti,tij,tj->t", radial, covariance, radial)
        across = np.einsum("ti,tij,tj->t", tangent, covariance, tangent)
        around = np.arctan2(away[:, 1], away[:, 0]) - turns - p[3]
        around = np.angle(np.exp(1j * around))
        return distance - p[2], along, around, across / distance**2 + turn_variance

    def residuals(p: Array) -> Array:
        off, along, around, turning = parts(p)
        moved = (p[:2] - marked[0]) / marked[1]
        return np.concatenate([off / np.sqrt(along * scale + 1e-6), around / np.sqrt(turning + sway**2), moved])

    away = points - start
    offset = np.angle(np.mean(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - turns))))
    p: Array = np.array([*start, float(np.median(np.linalg.norm(away, axis=1))), float(offset)])
    fit = None
    for _ in range(4):
        fit = least_squares(residuals, p, loss="soft_l1", x_scale=[*3 * [10.0], 0.01])
        p = np.asarray(fit.x, float)
        off, along, around, _ = parts(p)
        sway = max(1e-4, 1.4826 * float(np.median(np.abs(around))))
        scale = max(1.0, (1.4826 * float(np.median(np.abs(off / np.sqrt(along))))) ** 2)
    assert fit is not None
    off, _, around, _ = parts(p)
    correlated = 10.0  # neighbouring frames err alike
    deviation = np.sqrt(np.maximum(0, correlated * np.diag(np.linalg.pinv(fit.jac.T @ fit.jac))))
    rms = lambda x: 1.4826 * float(np.median(np.abs(x)))  # noqa: E731
    return Pivot(p[:2], float(p[2]), deviation[:3], rms(around), rms(off))
