"""One part that turns about a fixed pivot."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.progress import Advance
from keycld_model.tracking.alignment import Aligner, Poses, View, average, turn
from keycld_model.tracking.camera import Camera, diverse_frames, median_picture, within
from keycld_model.tracking.film import Film
from keycld_model.tracking.movers import CONTRAST, find_blobs, find_circle
from keycld_model.tracking.pivot import Pivot, fit_pivot
from keycld_model.tracking.shape import find_shape, thickest

Array = NDArray[np.float64]
LEARN = 60
"""Frames from which a part's appearance is learned."""
LEAST_WAY = 2.0
"""Working pixels by which a part must move."""
SEEN = 0.45
"""Share of a part that must be seen for its place to count."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part that was followed.

    Attributes:
        poses: in the reference picture.
        keypoint: [2], in the part's own coordinates, working pixels.
        thickness: working pixels, radius of the largest disc in it.
        seen: [T] bool, whether it was found in the frame.
        outline: [n, 2] pixels of its edge, own coordinates.
    """

    poses: Poses
    keypoint: Array
    thickness: float
    seen: NDArray[np.bool_]
    outline: Array

    def places(self, point: Array) -> tuple[Array, Array]:
        """A point of the part in the reference picture, [T, 2], and its covariance, [T, 2, 2]."""
        rotated = np.einsum("tij,j->ti", turn(self.poses.values[:, 0]), point)
        where = self.poses.values[:, 1:] + rotated
        carry = np.zeros((len(where), 2, 3))
        carry[:, 0, 0], carry[:, 1, 0] = -rotated[:, 1], rotated[:, 0]
        carry[:, 0, 1] = carry[:, 1, 2] = 1
        return where, np.einsum("tij,tjk,tlk->til", carry, self.poses.covariance, carry)


def follow(film: Film, camera: Camera, area: tuple[slice, slice], seed: int, advance: Advance) -> tuple[Part, Pivot]:
    """Find what turns about a pivot, learn how it looks, and align that to every frame.

    Args:
        film: the video.
        camera: its motion.
        area: rows and columns of the picture.
        seed: of the random search for the first circle.
        advance: a progress bar, three steps per frame.

    Raises:
        InputError: if nothing turns about one pivot.
    """
    picture = film.pixels[:, area[0], area[1]]
    background = median_picture(picture, within(camera, area))
    blobs = find_blobs(film, camera, background, area, advance)
    circle = find_circle(blobs, background.shape, np.random.default_rng(seed))
    if circle is None:
        raise InputError(
            f"{film.path}: nothing moves on a circle; film the mechanism with the camera at rest, seen along its axis, "
            "while it swings."
        )
    centre, radius, member = circle
    angles = _first_angles(film.times, blobs.centres, member, centre)
    poses = np.column_stack([angles, centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    poses[:, 0] -= angles[0]
    known = np.flatnonzero(member >= 0)
    frames = _learn_from(picture, known)
    view = View(film, camera, area)
    reach = int(min(radius, 0.45 * max(background.shape)))
    part, pivot = None, None
    for again in range(3):
        shape = find_shape(view, frames, poses, background, CONTRAST * blobs.noise, reach)
        keypoint, thickness = thickest(shape)
        look = average(view, frames, poses, shape)
        aligner = Aligner(view, look)
        chosen = np.arange(len(film)) if again == 2 else frames
        orbit = _orbit(poses[frames], centre, thickness)
        found = align_all(aligner, chosen, poses, orbit, advance if again == 2 else None)
        part = Part(found, keypoint, thickness, _good(found), look.points[look.mask])
        use = chosen[part.seen[chosen]]
        if len(use) < 6:
            raise InputError(f"{film.path}: what moves does not keep its appearance; film it sharper, or slower.")
        where, covariance = part.places(keypoint)
        pivot = fit_pivot(where[use], covariance[use], found.values[use, 0], found.covariance[use, 0, 0], centre)
        centre = pivot.centre
        if again < 2:
            poses = _redo(poses, found, use, centre)
            frames = use
    assert part is not None and pivot is not None
    _check_moved(film, part)
    return part, pivot


def align_all(aligner: Aligner, frames: NDArray[np.intp], guess: Array, orbit: Array, advance: Advance | None) -> Poses:
    """Align a part to frames, from the best of a guess, of what the frames before let expect, and of all its orbit.

    Args:
        aligner: of the part.
        frames: [n], indices.
        guess: [T, 3], poses.
        orbit: [m, 3], poses all around the pivot.
        advance: a progress bar, two steps per frame.
    """
    count = len(guess)
    values = np.full((count, 3), np.nan)
    covariance, misfit, seen = np.full((count, 3, 3), np.nan), np.full(count, np.inf), np.zeros(count)
    trail: list[Array] = []
    for t in frames:
        starts = [guess[t], aligner.search(t, orbit)]
        if len(frames) == count and trail:
            starts.append(np.array([guess[t, 0], *trail[-1][1:]]))
            starts += [np.array([guess[t, 0], *(2 * trail[-1] - trail[-2])[1:]])] if len(trail) > 1 else []
        start = min(starts, key=lambda p: aligner.cost(t, p))
        values[t], covariance[t], misfit[t], seen[t] = aligner.align(t, start, start[0])
        trail = [*trail[-1:], values[t]]
        if advance is not None:
            advance(2)
    return Poses(values, covariance, misfit, seen)


def _check_moved(film: Film, part: Part) -> None:
    """Refuse a part that hardly moves: what was taken for one is noise, or light.

    Raises:
        InputError: if its places lie closer than `LEAST_WAY`.
    """
    where = part.places(part.keypoint)[0][part.seen]
    way = float(np.hypot(*np.ptp(where, axis=0)))
    if way < LEAST_WAY:
        raise InputError(
            f"{film.path}: nothing moves by more than {way * film.scale:.1f} pixels; film a mechanism that swings."
        )


def _first_angles(times: Array, centres: Array, member: NDArray[np.intp], centre: Array) -> Array:
    """Angle of the blob on the circle in each frame, unwrapped, linear where there is none."""
    known = np.flatnonzero(member >= 0)
    away = centres[known, member[known]] - centre
    return np.interp(times, times[known], np.unwrap(np.arctan2(away[:, 1], away[:, 0])))


def _learn_from(picture: NDArray[np.uint8], known: NDArray[np.intp]) -> NDArray[np.intp]:
    """Frames that differ much, among those in which the part was seen."""
    return known[diverse_frames(picture[known], LEARN)] if len(known) > LEARN else known


def _good(poses: Poses) -> NDArray[np.bool_]:
    """Frames in which the part was found: enough of it is seen, and it looks as it does elsewhere."""
    known = np.isfinite(poses.values[:, 0])
    usual = float(np.median(poses.misfit[known & np.isfinite(poses.misfit)]))
    return known & (poses.seen > SEEN) & (poses.misfit < 4 * max(usual, 0.5))


def _orbit(poses: Array, centre: Array, thickness: float) -> Array:
    """Poses all around the pivot, half a thickness from one to the next, [m, 3]."""
    body = np.median(np.einsum("tij,tj->ti", turn(-poses[:, 0]), centre - poses[:, 1:]), axis=0)
    number = int(np.clip(4 * np.pi * np.linalg.norm(body) / max(thickness, 1.0), 24, 600))
    turns = np.arange(number) * 2 * np.pi / number
    return np.column_stack([turns, centre - turn(turns) @ body])


def _redo(poses: Array, found: Poses, use: NDArray[np.intp], centre: Array) -> Array:
    """Poses of all frames: places where the part was found, turned as they lie about the pivot; turns between them."""
    away = found.values[use, 1:] - centre
    angles = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    zero = np.angle(np.mean(np.exp(1j * (angles - poses[use, 0]))))
    # whole turns between frames in use are those of the earlier poses
    angles += 2 * np.pi * np.round((poses[use, 0] + zero - angles) / (2 * np.pi))
    redone = poses.copy()
    redone[:, 0] += np.interp(np.arange(len(poses)), use, angles - zero - poses[use, 0])
    backwards = turn(-redone[use, 0])
    body = np.median(np.einsum("tij,tj->ti", backwards, -away), axis=0)  # the pivot in the part's coordinates
    redone[:, 1:] = centre - np.einsum("tij,j->ti", turn(redone[:, 0]), body)
    redone[use, 1:] = found.values[use, 1:]
    return redone
