"""First guesses of where the links of a chain are, before it is known in detail how they look."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from keycld_envs.errors import InputError
from keycld_envs.progress import Advance
from keycld_model.discovery.frames import FRAMES, LONGEST
from keycld_model.discovery.parts import ANGLES, Joint, Placed, chart_of, placed
from keycld_model.discovery.shapes import CONTRAST as STARTING
from keycld_model.discovery.shapes import Alternation, Shape
from keycld_model.sampling import bilinear, grid
from keycld_model.tracking.alignment import turn
from keycld_model.tracking.camera import Camera, diverse_frames, median_picture, within
from keycld_model.tracking.film import Film
from keycld_model.tracking.movers import background_noise, find_blobs, find_circle
from keycld_model.tracking.shape import nearest_rod

Array = NDArray[np.float64]
BEYOND = 1.25
"""Lengths of a rod within which what hangs on its joint is sought: a bob reaches beyond its centre."""
ASIDE = 0.15
"""rad by which a link may be turned otherwise than a guess from small pictures: three of their steps."""
MARKED = 5.0
"""Working pixels by which a joint that somebody marked in a frame may be off."""


@dataclass(frozen=True, eq=False)
class Start:
    """A first guess of a chain of K links.

    Each link has coordinates of its own, working pixels, with an origin in its middle.

    Attributes:
        background: [h, w], the picture without what moves, in coordinates of the reference.
        noise: grey levels by which frames scatter about it.
        frames: [n], indices of frames from which looks can be learned.
        poses: [K, T, 3], near the true ones.
        joints: [K, 2], what each link hangs on: of the first in the reference picture, then in coordinates of the link
            before.
        tip: [2], the last keypoint, in coordinates of the last link; None if it is to be found.
        reach: [K], half sides of the squares in which links are sought, working pixels.
        marked: [K], working pixels by which the joints may be off; inf if nothing but the motion tells where they are.
        aside: rad, by which links may be turned otherwise; π if nothing is known of frames that are not in `frames`.
    """

    background: Array
    noise: float
    frames: NDArray[np.intp]
    poses: Array
    joints: Array
    tip: Array | None
    reach: tuple[int, ...]
    marked: Array
    aside: float


def from_circle(film: Film, camera: Camera, area: tuple[slice, slice], seed: int, advance: Advance) -> Start:
    """One link: the blob that moves on a circle.

    Args:
        film: the video.
        camera: its motion.
        area: rows and columns of the picture.
        seed: of the random search for the circle.
        advance: a progress bar, one step per frame.

    Raises:
        InputError: if nothing turns about one pivot.
    """
    background = median_picture(film.pixels[:, area[0], area[1]], within(camera, area))
    blobs = find_blobs(film, camera, background, area, advance)
    circle = find_circle(blobs, background.shape, np.random.default_rng(seed))
    if circle is None:
        raise InputError(
            f"{film.path}: nothing moves on a circle; film the mechanism with the camera at rest, seen along its axis, "
            "while it swings."
        )
    centre, radius, member = circle
    known = np.flatnonzero(member >= 0)
    away = blobs.centres[known, member[known]] - centre
    angles = np.interp(film.times, film.times[known], np.unwrap(np.arctan2(away[:, 1], away[:, 0])))
    poses = np.column_stack([angles, centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    poses[:, 0] -= angles[0]
    reach = int(min(radius, 0.45 * max(background.shape)))
    return Start(background, blobs.noise, known, poses[None], centre[None], None, (reach,), np.full(1, np.inf), np.pi)


def from_points(
    film: Film, camera: Camera, area: tuple[slice, slice], points: Array, frame: int, advance: Advance
) -> Start:
    """A chain whose joints are known in one frame: each link is what turns about its joint, in small pictures.

    Args:
        film: the video.
        camera: its motion.
        area: rows and columns of the picture.
        points: [K + 1, 2], pivot and keypoints in that frame, pixels of the video.
        frame: its index.
        advance: a progress bar, one step per frame.
    """
    picture = film.pixels[:, area[0], area[1]]
    background = median_picture(picture, within(camera, area))
    origin = np.array([area[1].start, area[0].start], float)
    noise = background_noise(film, camera, background, grid(*background.shape) + origin)
    known = camera.to_reference(frame, (points + 0.5) / film.scale - 0.5)
    rods = np.diff(known, axis=0)
    step = max(1, -(-max(background.shape) // LONGEST))
    small = _Small(film, camera, background, origin, step)
    images = np.stack([small(t, advance) for t in range(len(film))])
    some = np.union1d(diverse_frames(picture, FRAMES), [frame])
    now = _hung(images, small.background, some, (known - origin + 0.5) / step - 0.5, int(np.searchsorted(some, frame)))
    poses = np.zeros((len(rods), len(film), 3))
    for first in range(0, len(film), FRAMES):
        piece = slice(first, first + FRAMES)
        for pose, found, rod in zip(poses, placed(images[piece], small.background, now.parts).poses, rods, strict=True):
            hinge = (found.origin + 0.5) * step - 0.5 + origin
            pose[piece] = np.column_stack([found.angle, hinge + turn(found.angle) @ (rod / 2)])
    lengths = np.linalg.norm(rods, axis=1)
    joints = np.vstack([known[0], rods[:-1] / 2])
    reach = tuple(int(min(length, 0.45 * max(background.shape))) for length in lengths)
    height, width = background.shape
    outside = ((known[:-1] < origin) | (known[:-1] > origin + np.array([width, height]))).any(axis=1)
    marked = np.where(outside, np.inf, MARKED)
    return Start(background, noise, some, poses, joints, rods[-1] / 2, reach, marked, ASIDE)


class _Small:
    """Frames in coordinates of the reference picture, reduced for the discovery of parts.

    Attributes:
        background: [h, w, 3], 0 to 1.
    """

    def __init__(self, film: Film, camera: Camera, background: Array, origin: Array, step: int) -> None:
        self.film, self.camera, self.step = film, camera, step
        height, width = (side // step for side in background.shape)
        self.points = (grid(height, width) + 0.5) * step - 0.5
        self.where = self.points + origin
        self.background = self._reduced(background, self.points)

    def __call__(self, t: int, advance: Advance) -> NDArray[np.float32]:
        """Frame t, [h, w, 3], 0 to 1; the background where it does not reach."""
        advance()
        small = self._reduced(self.film.pixels[t], self.camera.to_frame(t, self.where))
        return np.where(np.isfinite(small), small, self.background)

    def _reduced(self, image: NDArray[np.uint8] | Array, points: Array) -> NDArray[np.float32]:
        means = ndimage.uniform_filter(image.astype(np.float32), self.step)
        return np.repeat(bilinear(means, points)[..., None] / 255, 3, axis=-1).astype(np.float32)


def _hung(
    images: NDArray[np.float32], background: NDArray[np.float32], some: NDArray[np.intp], known: Array, at: int
) -> Placed:
    """The links one after the other, each on the one before.

    Args:
        images: [T, h, w, 3].
        background: [h, w, 3].
        some: [n], frames in which links are learned.
        known: [K + 1, 2], pivot and keypoints in frame `some[at]`, pixels of these images.
        at: index into `some`.
    """
    now = Placed.nothing(images[some], background)
    rods = np.diff(known, axis=0)
    for k, rod in enumerate(rods):
        place = known[0] if k == 0 else rods[k - 1]
        joint = Joint("hinge", k - 1 if k else None, (float(place[0]), float(place[1])))
        size = (ANGLES, max(3, round(BEYOND * float(np.linalg.norm(rod)))))
        chart = chart_of(joint, now.parent(joint), size)
        frames = Alternation(now.stack(), chart)
        raw = frames.error[at] / frames.area
        own = nearest_rod(known[k] + chart.offsets(), known) == k
        there = own & (raw > STARTING * raw.max(initial=0, where=own))
        fit = frames.refine(Shape(there.astype(np.float32), frames.values[at]))
        now = now.with_part(joint, fit, size)
    return now.swept(learn=True)
