"""Alignment of a moving part's appearance: its pose in each frame by inverse-compositional Gauss-Newton."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from keycld_model.sampling import bilinear
from keycld_model.tracking.camera import Camera
from keycld_model.tracking.film import Film

Array = NDArray[np.float64]
ITERATIONS = 25
SMOOTH = 0.8
"""Width of the filter against noise of pixels, working pixels."""
SWAY = 0.1
"""rad by which a part may be turned otherwise than its place on the circle tells."""
LIGHT = np.array([25.0, 0.25])
"""Grey levels, and share of the contrast, by which the light on a part may change: else nothing could pass for it."""
SOUGHT = 400
"""Pixels of a part by which it is sought."""
TUKEY = 5.0
"""Scatter beyond which a pixel does not count (covered, or a highlight)."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """How a part looks in its own coordinates.

    Attributes:
        points: [N, 2], working pixels from the part's origin, at pose zero.
        values: [N], mean grey level over frames.
        precision: [N], 1 / variance over frames.
        gradient: [N, 2], grey levels per working pixel.
        mask: [N] bool, whether the part itself is there, and not what is around it.
    """

    points: Array
    values: Array
    precision: Array
    gradient: Array
    mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Poses:
    """Where a part was found.

    Attributes:
        values: [T, 3], turn (rad, image axes, from x to y down) and place of its origin (working pixels, reference).
        covariance: [T, 3, 3].
        misfit: [T], root mean square difference from the appearance over its scatter; about 1.
        size: [T], robust size of the differences from the appearance, in its scatter; at least 1.
        seen: [T], the share of the part, by information, that is in the picture and not covered.
    """

    values: Array
    covariance: Array
    misfit: Array
    size: Array
    seen: Array


def turn(angle: float | Array) -> Array:
    """Matrices [..., 2, 2] that turn by an angle, rad, from x to y (down)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def place(pose: Array, points: Array) -> Array:
    """Points [N, 2] of a part at a pose [3], in the reference picture."""
    return points @ turn(pose[0]).T + pose[1:]


class View:
    """The frames of a film, sampled at points of the reference picture."""

    def __init__(self, film: Film, camera: Camera, area: tuple[slice, slice]) -> None:
        self.film, self.camera, self.area = film, camera, area

    def __call__(self, t: int, points: Array) -> Array:
        """Grey levels of frame t at `points` [..., 2], smoothed; NaN outside the picture."""
        where = self.camera.to_frame(t, points) if self.camera.moves else points
        rows, columns = self.area
        low = np.array([columns.start, rows.start])
        high = np.array([columns.stop, rows.stop])
        first = np.clip(np.floor(np.nanmin(where.reshape(-1, 2), axis=0)).astype(int) - 4, low, high - 2)
        last = np.clip(np.ceil(np.nanmax(where.reshape(-1, 2), axis=0)).astype(int) + 5, first + 2, high)
        crop = self.film.pixels[t, first[1] : last[1], first[0] : last[0]]
        return bilinear(ndimage.gaussian_filter(crop.astype(np.float32), SMOOTH), where - first)


def average(view: View, frames: NDArray[np.intp], poses: Array, shape: "Shape") -> Appearance:
    """The mean appearance over frames, and its precision.

    Args:
        view: the frames.
        frames: [n], indices.
        poses: [T, 3].
        shape: the region of the part.
    """
    stack = np.stack([view(t, place(poses[t], shape.grid)) for t in frames])
    there = np.isfinite(stack[:, shape.mask]).any(axis=1)
    stack = stack[there]
    light = np.nanmedian(stack[:, shape.mask], axis=1)
    stack = stack - (light - np.nanmedian(light))[:, None, None] if np.isfinite(light).all() else stack
    known = np.isfinite(stack).sum(axis=0)
    total = np.where(known > 0, known, 1)
    mean = np.nansum(stack, axis=0) / total
    variance = np.nansum((stack - mean) ** 2, axis=0) / np.maximum(total - 1, 1)
    gradient = np.stack([np.gradient(mean, axis=1), np.gradient(mean, axis=0)], axis=-1)
    usable = shape.window & (known >= max(3, 0.3 * len(stack)))
    inner = float(np.median(variance[usable])) if usable.any() else 1.0
    precision = 1 / (variance + 0.25 * inner + 0.5)
    return Appearance(shape.grid[usable], mean[usable], precision[usable], gradient[usable], shape.mask[usable])


@dataclass(frozen=True, eq=False)
class Shape:
    """The region of a part in its own coordinates.

    Attributes:
        grid: [h, w, 2], working pixels from the origin.
        mask: [h, w] bool, the part itself.
        window: [h, w] bool, the part and its rim.
    """

    grid: Array
    mask: NDArray[np.bool_]
    window: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Check that the part is there at all."""
        assert self.mask.any()


class Aligner:
    """Fits the pose of one part to frames."""

    def __init__(self, view: View, look: Appearance) -> None:
        self.view, self.look = view, look
        x, y = look.points.T
        gx, gy = look.gradient.T
        contrast = look.values - look.values.mean()
        self.jacobian = np.stack([-gx * y + gy * x, gx, gy, np.ones(len(x)), contrast], axis=1)
        self.reach = max(1.0, float(np.sqrt((look.points**2).sum(axis=1).mean())))

    def align(self, t: int, start: Array, turned: float) -> tuple[Array, Array, float, float, float]:
        """The pose in frame t.

        Args:
            t: the frame.
            start: [3], pose to start from.
            turned: rad, the turn that is expected, within `SWAY`: a round bob does not show how it is turned.

        Returns:
            pose [3], covariance [3, 3], misfit, size, and the share that is seen; as the attributes of `Poses`.
        """
        pose = start.copy()
        light = np.zeros(2)
        prior = np.diag([SWAY**-2, 0, 0, 0, 0])
        for _ in range(ITERATIONS):
            error, there = self._error(t, pose, light)
            if there.sum() < 20:
                return start, np.full((3, 3), np.nan), np.inf, np.inf, 0.0
            weight = self._weight(error, there)
            weighted = self.jacobian * weight[:, None]
            normal = (
                weighted.T @ self.jacobian + 1e-9 * np.diag((weighted * self.jacobian).sum(axis=0)) + 1e-12 * np.eye(5)
            )
            pull = np.array([(pose[0] - turned) / SWAY**2, 0, 0, 0, 0])
            step = np.linalg.solve(normal + prior, weighted.T @ np.where(there, error, 0) + pull)
            limit = min(1.0, 6.0 / max(np.hypot(*step[1:3]), abs(step[0]) * self.reach, 1e-9))
            pose = self._compose(pose, np.asarray(-limit * step[:3], float))
            light = np.clip(light + step[3:], -LIGHT, LIGHT)
            if np.hypot(*step[1:3]) < 0.002 and abs(step[0]) * self.reach < 0.002:
                break
        error, there = self._error(t, pose, light)
        weight = self._weight(error, there)
        normal = (self.jacobian * weight[:, None]).T @ self.jacobian + 1e-12 * np.eye(5) + prior
        full = (self.jacobian[:, 1:3] ** 2 * self.look.precision[:, None]).sum()
        size = self._size(error, there)
        seen = float((self.jacobian[:, 1:3] ** 2 * weight[:, None]).sum() * size**2 / full)
        scaled = np.where(there, error, 0) ** 2 * self.look.precision
        misfit = float(np.sqrt(scaled.sum() / max(1, there.sum())))
        local = np.linalg.inv(normal)[:3, :3]
        carry = np.eye(3)
        carry[1:, 1:] = turn(pose[0])
        return pose, carry @ local @ carry.T, misfit, size, seen

    def cost(self, t: int, pose: Array) -> float:
        """Robust mean misfit at a pose, without fitting."""
        error, there = self._error(t, pose, np.zeros(2))
        if there.sum() < 0.3 * len(there):
            return np.inf
        error = error - np.clip(np.median(error[there]), -LIGHT[0], LIGHT[0])
        return float(np.minimum(error[there] ** 2 * self.look.precision[there], TUKEY**2).mean())

    def search(self, t: int, poses: Array) -> Array:
        """The one of many poses [n, 3] that fits a frame best, judged by a few pixels."""
        some = slice(None, None, max(1, len(self.look.points) // SOUGHT))
        points, values, precision = self.look.points[some], self.look.values[some], self.look.precision[some]
        where = np.einsum("nij,kj->nki", turn(poses[:, 0]), points) + poses[:, None, 1:]
        error = self.view(t, where) - values
        there = np.isfinite(error)
        error = np.where(there, error, 0)
        error -= np.clip(error.sum(axis=1) / np.maximum(1, there.sum(axis=1)), -LIGHT[0], LIGHT[0])[:, None]
        cost = (np.minimum(error**2 * precision, TUKEY**2) * there).sum(axis=1) / np.maximum(1, there.sum(axis=1))
        return poses[np.argmin(np.where(there.mean(axis=1) > 0.5, cost, np.inf))]

    def _error(self, t: int, pose: Array, light: Array) -> tuple[Array, NDArray[np.bool_]]:
        values = self.view(t, place(pose, self.look.points))
        there = np.isfinite(values)
        modelled = self.look.values + light[0] + light[1] * self.jacobian[:, 4]
        return values - modelled, there

    def _weight(self, error: Array, there: NDArray[np.bool_]) -> Array:
        scaled = np.where(there, error, 0) * np.sqrt(self.look.precision)
        size = self._size(error, there)
        robust = np.clip(1 - (scaled / (TUKEY * size)) ** 2, 0, None) ** 2
        return np.where(there, robust * self.look.precision / size**2, 0)

    def _size(self, error: Array, there: NDArray[np.bool_]) -> float:
        """Robust size of errors that are there, in their usual scatter."""
        return max(1.0, 1.4826 * float(np.median(np.abs(error[there]) * np.sqrt(self.look.precision[there]))))

    @staticmethod
    def _compose(pose: Array, step: Array) -> Array:
        """The pose after a small motion `step` in the part's own coordinates."""
        return np.array([pose[0] + step[0], *(pose[1:] + turn(pose[0]) @ step[1:])])
