"""How the camera itself moved: a shift, a turn and a zoom of each frame against a reference frame."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_envs.progress import Advance
from keycld_model.sampling import bilinear, grid

Array = NDArray[np.float64]
ITERATIONS = 10
TILES = 16
"""Parts along the longer side of the picture that have each their share of marks."""
SMOOTH = 1.0
"""Width of the filter against noise of pixels, working pixels."""
ZOOM, TURN = 0.001, 0.003
"""How far a camera is expected to zoom (relative) and turn (rad): priors for scenes with few marks."""
STEP = 0.5
"""Pixels by which it is expected to shift from frame to frame: keeps hold of the background where it has few marks."""
LEVER = 0.25
"""Spread of the marks, in half widths of the picture, below which a turn cannot be told from a shift."""
MARKED, FEWEST = 5.0, 500
"""Gradients that stand out, in medians of all; how many pixels are used in any case."""
CORRELATED = np.array([3000.0, 3000.0, 30.0, 30.0])
"""How many pixels of compressed video err alike, over blocks and over frames; turns are the first to suffer."""
STILL = 0.35
"""Working pixels by which the corners of the picture may seem to move under a camera that stands still."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Where the points of the reference picture lie in each frame: A_t x + b_t.

    Attributes:
        linear: [T, 2, 2], a turn times a zoom.
        shift: [T, 2], working pixels.
        moves: whether the camera moved; if not, all frames are the reference.
        travel: [T] largest way of a corner of the picture, working pixels.
    """

    linear: Array
    shift: Array
    moves: bool
    travel: Array

    def to_frame(self, t: int, points: Array) -> Array:
        """Points [..., 2] of the reference picture, as they lie in frame t."""
        return points @ self.linear[t].T + self.shift[t]

    def to_reference(self, t: int, points: Array) -> Array:
        """Points [..., 2] of frame t, as they lie in the reference picture."""
        return (points - self.shift[t]) @ np.linalg.inv(self.linear[t]).T

    @classmethod
    def still(cls, count: int, travel: Array | None = None) -> "Camera":
        """A camera that does not move."""
        travel = np.zeros(count) if travel is None else travel
        return cls(np.tile(np.eye(2), (count, 1, 1)), np.zeros((count, 2)), False, travel)


def picture_area(pixels: NDArray[np.uint8]) -> tuple[slice, slice]:
    """Rows and columns of the picture inside black bars, which are dark and alike in all frames."""
    some = pixels[:: max(1, len(pixels) // 16)].astype(np.float32)
    centre, low = some.mean(axis=0), np.quantile(some, 0.01)
    dead = (some.std(axis=0) < 2) & (centre < low + 8)
    slices = []
    for axis in (1, 0):
        share = dead.mean(axis=axis)
        alive = np.flatnonzero(share < 0.75)
        whole = len(alive) == 0 or len(alive) < 0.2 * len(share)
        first, last = (0, len(share) - 1) if whole else (int(alive[0]), int(alive[-1]))
        margin = 3
        slices.append(slice(first + (margin if first else 0), last + 1 - (margin if last < len(share) - 1 else 0)))
    return slices[0], slices[1]


def camera_motion(pixels: NDArray[np.uint8], area: tuple[slice, slice], advance: Advance) -> Camera:
    """Follow the background, which most of the picture shows, by robust Gauss-Newton.

    Moving things vanish from the median of all frames. Frames are aligned to it, each from where the one before it was
    found, then to the median of the aligned frames, in which the background is sharp.

    Args:
        pixels: [T, h, w].
        area: rows and columns of the picture inside black bars.
        advance: a progress bar, one step per frame, and some hundreds.
    """
    rows, columns = area
    picture = pixels[:, rows, columns]
    count, height, width = picture.shape
    every = max(1, count // 100)
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    motions, free = np.zeros((count, 4)), True
    some = list(range(0, count, every))
    reference = median_picture(picture, Camera.still(count), some[:: max(1, len(some) // 41)])
    for frames, blur in ((some, 4 * SMOOTH), (some, SMOOTH), (list(range(count)), SMOOTH)):
        aligner = BackgroundAligner(_smooth(reference, blur), free=free)
        middle = len(frames) // 2
        for order in (frames[middle:], frames[middle::-1]):
            last = motions[order[0]]
            for t in order:
                last = motions[t] = aligner.align(_smooth(picture[t], blur), last)
                advance()
        if frames is some:
            free = aligner.tells_turns
            motions = np.stack([np.interp(np.arange(count), some, m[some]) for m in motions.T], axis=1)
            motions[:, :2] *= free
            reference = median_picture(picture, _camera(motions, centre))
    camera = _camera(motions, centre)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], float)
    travel = np.array([np.linalg.norm(camera.to_frame(t, corners) - corners, axis=1).max() for t in range(count)])
    if np.quantile(travel, 0.95) < STILL:
        return Camera.still(count, travel)
    origin = np.array([columns.start, rows.start], float)
    return Camera(camera.linear, camera.shift + origin - camera.linear @ origin, True, travel)


def median_picture(picture: NDArray[np.uint8], camera: Camera, frames: list[int] | None = None) -> Array:
    """The median over some frames, by default ones that differ much, in the reference's coordinates, [h, w]."""
    height, width = picture.shape[1:]
    points = grid(height, width)
    chosen = diverse_frames(picture, 41) if frames is None else frames
    stack = np.stack([bilinear(picture[t], camera.to_frame(t, points)).astype(np.float32) for t in chosen])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a pixel that no frame shows
        median = np.nanmedian(stack, axis=0)
    return np.where(np.isfinite(median), median, np.nanmean(median)).astype(float)


def diverse_frames(picture: NDArray[np.uint8], number: int) -> list[int]:
    """Frames of which each differs as much as possible from those before it: a thing at rest is in few of them."""
    every = max(1, len(picture) // 400)
    step = max(1, max(picture.shape[1:]) // 64)
    thumbnails = picture[::every, ::step, ::step].reshape(-(-len(picture) // every), -1).astype(np.float32)
    chosen = [0]
    distance = np.full(len(thumbnails), np.inf, np.float32)
    while len(chosen) < min(number, len(thumbnails)):
        distance = np.minimum(distance, ((thumbnails - thumbnails[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
    return sorted({every * i for i in chosen})


def _smooth(image: NDArray[Any], sigma: float) -> Array:
    return gaussian_filter(image.astype(np.float32), sigma).astype(float)


def _camera(motions: Array, centre: Array) -> Camera:
    """Motions (zoom - 1, turn, x, y) about the centre of the picture, as a camera."""
    linear = np.array([[[1 + a, -b], [b, 1 + a]] for a, b, _, _ in motions])
    return Camera(linear, centre + motions[:, 2:] - linear @ centre, True, np.zeros(len(motions)))


def _marks(strength: Array, number: int) -> NDArray[np.bool_]:
    """Up to `number` pixels whose gradients stand out, not more than a few in each tile of the picture.

    A thing that moves, however marked, is then a minority that robust weights can leave out.
    """
    strength = strength.copy()
    strength[[0, 1, -2, -1]] = strength[:, [0, 1, -2, -1]] = 0
    least = MARKED * float(np.median(strength))
    side = max(4, round(max(strength.shape) / TILES))
    each = 4 * number * side * side // strength.size + 1
    chosen = np.zeros(strength.shape, bool)
    for top in range(0, strength.shape[0], side):
        for left in range(0, strength.shape[1], side):
            tile = strength[top : top + side, left : left + side]
            bound = float(np.partition(tile.ravel(), -each)[-each]) if tile.size > each else 0.0
            chosen[top : top + side, left : left + side] = tile > max(bound, least)
    return chosen if chosen.sum() >= FEWEST else strength >= np.partition(strength.ravel(), -FEWEST)[-FEWEST]


def within(camera: Camera, area: tuple[slice, slice]) -> Camera:
    """The same camera for coordinates of the picture inside black bars."""
    origin = np.array([area[1].start, area[0].start], float)
    return Camera(camera.linear, camera.shift - origin + camera.linear @ origin, camera.moves, camera.travel)


class BackgroundAligner:
    """A reference image, to which others are aligned by a similarity about its centre."""

    def __init__(self, reference: Array, number: int = 5000, free: bool = True) -> None:
        """Take up to `number` pixels with the strongest gradients, as far as these stand out."""
        height, width = reference.shape
        self.centre = np.array([(width - 1) / 2, (height - 1) / 2])
        self.spread = np.array([ZOOM, TURN]) if free else np.full(2, 1e-6)
        rows, columns = np.asarray(np.gradient(reference))
        strong = np.hypot(rows, columns)
        chosen = _marks(strong, number)
        self.points, self.values = grid(height, width)[chosen] - self.centre, reference[chosen]
        self.gradient = np.stack([columns[chosen], rows[chosen]], axis=-1)
        x, y = self.points.T
        gx, gy = self.gradient.T
        self.jacobian = np.stack([gx * x + gy * y, gy * x - gx * y, gx, gy], axis=1)

    @property
    def tells_turns(self) -> bool:
        """Whether the marks lie far enough apart that a turn or a zoom differs from a shift."""
        spread = np.linalg.svd(self.points - self.points.mean(axis=0), compute_uv=False) / len(self.points) ** 0.5
        return bool(spread.min() > LEVER * self.centre.max())

    def align(self, image: Array, start: Array) -> Array:
        """Zoom - 1, turn and shift (a, b, x, y) under which the reference becomes `image`."""
        p: Array = start.copy()
        before = start * np.array([0.0, 0.0, 1.0, 1.0])
        for _ in range(ITERATIONS):
            linear = np.array([[1 + p[0], -p[1]], [p[1], 1 + p[0]]])
            error = bilinear(image, self.points @ linear.T + self.centre + p[2:]) - self.values
            there = np.isfinite(error)
            if there.sum() < 50:
                return start
            error = error[there] - np.median(error[there])
            size = 1.4826 * np.median(np.abs(error)) + 0.5
            weight = np.clip(1 - (error / (4.7 * size)) ** 2, 0, None) ** 2
            jacobian = self.jacobian[there]
            weighted = jacobian * weight[:, None]
            prior = size**2 * CORRELATED / np.array([*self.spread, STEP, STEP]) ** 2
            normal = weighted.T @ jacobian + np.diag(prior)
            # the reference moves by the step, then by the present motion (inverse compositional)
            step = np.linalg.lstsq(normal, -weighted.T @ error - prior * (p - before), rcond=1e-10)[0]
            shift = linear @ step[2:]
            p = p + np.concatenate([linear @ step[:2], shift])
            if np.abs(step * np.array([200.0, 200.0, 1.0, 1.0])).max() < 0.01:
                break
        return p
