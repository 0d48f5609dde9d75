"""The direction of a visible rod or string, from the keypoint towards the pivot."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from keycld_model.tracking.camera import Camera
from keycld_model.tracking.film import Film

Array = NDArray[np.float64]
FRAMES = 240
"""Frames in which rods are sought."""
FAN = 0.35
"""rad on each side of the expected direction."""
STANDS_OUT = 6.0
"""Robust scatters of other directions by which that of a rod stands out."""
LEAST = 30


@dataclass(frozen=True, eq=False)
class Rods:
    """Straight lines through the keypoint.

    Attributes:
        frames: [n], indices of frames in which a rod was seen.
        directions: [n], rad, of the line in the reference picture from the keypoint on, `atan2(row, column)`.
    """

    frames: NDArray[np.intp]
    directions: Array


def find_rods(film: Film, camera: Camera, area: tuple[slice, slice], places: Array, pivot: Array, clear: float) -> Rods:
    """Seek a line from the keypoint towards the pivot that is darker or brighter than what is beside it.

    Args:
        film: the video.
        camera: its motion.
        area: rows and columns of the picture.
        places: [T, 2], keypoint in the reference picture; NaN where it was not found.
        pivot: [2], roughly.
        clear: working pixels around the keypoint that do not belong to the rod.
    """
    fan = np.linspace(-FAN, FAN, round(2 * FAN / 0.004) + 1)
    kept, found = [], []
    known = np.flatnonzero(np.isfinite(places[:, 0]))
    for t in known[:: max(1, len(known) // FRAMES)]:
        towards = np.arctan2(*(pivot - places[t])[::-1])
        length = float(np.linalg.norm(pivot - places[t]))
        along = np.arange(1.8 * clear + 4, 0.95 * length, 1.5)
        rays = towards + fan
        points = places[t] + along[None, :, None] * np.stack([np.cos(rays), np.sin(rays)], axis=1)[:, None]
        contrast = _line_contrast(film, camera, area, int(t), points)
        direction = _best(contrast, fan)
        if direction is not None:
            kept.append(t)
            found.append(towards + direction)
    return Rods(np.array(kept, np.intp), np.array(found))


def _line_contrast(film: Film, camera: Camera, area: tuple[slice, slice], t: int, points: Array) -> Array:
    """Mean of a filter for thin lines along each ray, [number of rays]; NaN for rays that are hardly in the picture."""
    image = film.pixels[t].astype(np.float32)
    lines = ndimage.gaussian_filter(image, 1.0) - ndimage.gaussian_filter(image, 4.0)
    where = camera.to_frame(t, points)
    rows, columns = area
    x, y = where[..., 0], where[..., 1]
    inside = (x > columns.start + 2) & (x < columns.stop - 3) & (y > rows.start + 2) & (y < rows.stop - 3)
    values = ndimage.map_coordinates(lines, [np.where(inside, y, 0), np.where(inside, x, 0)], order=1)
    clipped = np.clip(values, -6, 6) * inside
    number = inside.sum(axis=1)
    return np.where(number > 20, clipped.sum(axis=1) / np.maximum(number, 1), np.nan)


def _best(contrast: Array, fan: Array) -> float | None:
    """The direction that stands out, between the directions that were tried; None if none does."""
    known = np.isfinite(contrast)
    if known.sum() < 0.5 * len(fan):
        return None
    away = np.where(known, contrast - np.nanmedian(contrast), 0)
    spread = 1.4826 * float(np.median(np.abs(away[known]))) + 0.05
    i = int(np.argmax(np.abs(away)))
    if abs(away[i]) < STANDS_OUT * spread or not 0 < i < len(fan) - 1:
        return None
    left, top, right = np.abs(away[i - 1 : i + 2])
    bend = left - 2 * top + right
    return float(fan[i] + (0.5 * (left - right) / bend if bend < 0 else 0) * (fan[1] - fan[0]))


def meeting_point(places: Array, rods: Rods) -> tuple[Array, Array, float] | None:
    """The point that all rods point at: the pivot, without a circle.

    Args:
        places: [T, 2], keypoint in the reference picture.
        rods: their directions.

    Returns:
        The point [2], its standard deviations [2], and the robust scatter of directions about it, rad; None if too few
        rods were seen, or they are nearly parallel.
    """
    if len(rods.frames) < LEAST or np.ptp(np.unwrap(rods.directions)) < 0.1:
        return None
    at = places[rods.frames]
    normal = np.stack([-np.sin(rods.directions), np.cos(rods.directions)], axis=1)

    def residuals(c: Array) -> Array:
        away = c - at
        return (normal * away).sum(axis=1) / np.maximum(np.linalg.norm(away, axis=1), 1.0)

    linear = np.linalg.lstsq(normal, (normal * at).sum(axis=1), rcond=None)[0]
    fit = least_squares(residuals, linear, loss="soft_l1", f_scale=0.003)
    size = 1.4826 * float(np.median(np.abs(fit.fun)))
    independent = 4.0
    deviation = size * np.sqrt(independent * np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)))
    return fit.x, deviation, size
