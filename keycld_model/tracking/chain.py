"""A chain of links: the first turns about a fixed pivot, each other one about the end of the one before."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.progress import Advance
from keycld_model.tracking.alignment import Aligner, Poses, View, average, turn
from keycld_model.tracking.camera import Camera, diverse_frames
from keycld_model.tracking.film import Film
from keycld_model.tracking.movers import CONTRAST
from keycld_model.tracking.pivot import Pivot, fit_pivot
from keycld_model.tracking.shape import find_shape, thickest
from keycld_model.tracking.starts import Start

Array = NDArray[np.float64]
LEARN = 60
"""Frames from which a part's appearance is learned."""
LEAST_WAY = 2.0
"""Working pixels by which a part must move."""
SEEN = 0.45
"""Share of a part that must be seen for its place to count."""
OTHER = 4.0
"""Misfit, in medians of all frames, from which on something else is seen than the part."""
FEWEST = 6
"""Frames in which a part must be seen."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part that was followed.

    Attributes:
        poses: in the reference picture.
        keypoint: [2], in the part's own coordinates, working pixels.
        thickness: working pixels, radius of the largest disc in it.
        seen: [T] bool, whether it was found in the frame.
    """

    poses: Poses
    keypoint: Array
    thickness: float
    seen: NDArray[np.bool_]

    def places(self, point: Array) -> tuple[Array, Array]:
        """A point of the part in the reference picture, [T, 2], and its covariance, [T, 2, 2]."""
        rotated = np.einsum("tij,j->ti", turn(self.poses.values[:, 0]), point)
        return self.poses.values[:, 1:] + rotated, _carried(rotated, self.poses.covariance)


def follow(
    film: Film, camera: Camera, area: tuple[slice, slice], start: Start, advance: Advance
) -> tuple[list[Part], list[Pivot]]:
    """Learn how each link of a chain looks, and align that to every frame.

    Args:
        film: the video.
        camera: its motion.
        area: rows and columns of the picture.
        start: a first guess of K links.
        advance: a progress bar, 2 K steps per frame.

    Returns:
        The K links, and what each turns about: the first in the reference picture, others in coordinates of the link
        before.

    Raises:
        InputError: if a link does not keep its appearance, or hardly moves.
    """
    view, everything = View(film, camera, area), np.arange(len(film))
    learned = [_learn_from(film.pixels[:, area[0], area[1]], start.frames)] * len(start.poses)
    poses, joints = list(start.poses), start.joints
    parts: list[Part] = []
    pivots: list[Pivot] = []
    for again in range(3):
        last, tip = again == 2, parts[-1].keypoint if parts else start.tip
        rods = chain_ends(poses, joints, np.zeros(2) if tip is None else tip)
        parts, anchor = [], rods[:, 0]
        for k, frames in enumerate(learned):
            threshold = CONTRAST * start.noise
            shape = find_shape(view, frames, poses[k], start.background, threshold, start.reach[k], rods, k)
            hinge = _hinge(poses[k][frames], anchor[frames])
            keypoint, thickness = thickest(shape, hinge)
            aligner = Aligner(view, average(view, frames, poses[k], shape))
            orbit = _orbit(hinge, thickness)
            chosen = everything if last else frames
            found = align_all(aligner, chosen, poses[k], orbit, anchor, start.aside, advance if last else None)
            if start.tip is not None and np.linalg.norm(keypoint - start.tip) > thickness:
                keypoint = start.tip  # what was marked is not the thickest place
            part = Part(found, keypoint, thickness, _good(found, strict=last))
            if part.seen.sum() < FEWEST:
                raise InputError(f"{film.path}: what moves does not keep its appearance; film it sharper, or slower.")
            parts.append(part)
            if k + 1 < len(learned):
                anchor = _end(_redo(poses[k], part, anchor), joints[k + 1])
        parts, pivots = _joined(parts, joints, start)
        joints = np.stack([pivot.centre for pivot in pivots])
        if not last:
            anchor = np.tile(joints[0], (len(film), 1))
            for k, part in enumerate(parts):
                poses[k] = _redo(poses[k], part, anchor)
                learned[k] = np.flatnonzero(part.seen)
                anchor = _end(poses[k], part.keypoint)
    _check_moved(film, parts)
    return parts, pivots


def chain_ends(poses: list[Array], joints: Array, tip: Array) -> Array:
    """Pivot and ends of all rods, [T, K + 1, 2], in the reference picture.

    Args:
        poses: K times [T, 3].
        joints: [K, 2], of the first link in the reference picture, then in coordinates of the link before.
        tip: [2], in coordinates of the last link.
    """
    ends = [_end(pose, point) for pose, point in zip(poses, [*joints[1:], tip], strict=True)]
    return np.stack([np.broadcast_to(joints[0], ends[0].shape), *ends], axis=1)


def _end(poses: Array, point: Array) -> Array:
    """A point [2] of a link in the reference picture, [T, 2]."""
    return poses[:, 1:] + turn(poses[:, 0]) @ point


def _joined(parts: list[Part], joints: Array, start: Start) -> tuple[list[Part], list[Pivot]]:
    """What each link turns about, from the last link to the first: that is the keypoint of the link before.

    Args:
        parts: K links.
        joints: [K, 2], near.
        start: the first guess, which holds joints that a motion does not show.
    """
    parts, pivots = list(parts), []
    for k in reversed(range(len(parts))):
        part, use = parts[k], parts[k].seen
        where, covariance = part.places(part.keypoint)
        turns, variance = part.poses.values[:, 0], part.poses.covariance[:, 0, 0]
        if k:
            use = use & parts[k - 1].seen
            where, covariance, turns, variance = _within(parts[k - 1].poses, where, covariance, turns, variance)
        pivot = fit_pivot(
            where[use], covariance[use], turns[use], variance[use], joints[k], (start.joints[k], start.marked[k])
        )
        pivots.insert(0, pivot)
        if k:
            parts[k - 1] = replace(parts[k - 1], keypoint=pivot.centre)
    return parts, pivots


def _within(
    parent: Poses, where: Array, covariance: Array, turns: Array, variance: Array
) -> tuple[Array, Array, Array, Array]:
    """Places [T, 2] and turns [T] with their covariances [T, 2, 2] and variances [T] in coordinates of another link."""
    away, back = where - parent.values[:, 1:], turn(-parent.values[:, 0])
    covariance = back @ (covariance + _carried(away, parent.covariance)) @ np.swapaxes(back, 1, 2)
    turns, variance = turns - parent.values[:, 0], variance + parent.covariance[:, 0, 0]
    return np.einsum("tij,tj->ti", back, away), covariance, turns, variance


def _carried(away: Array, covariance: Array) -> Array:
    """Covariance [T, 2, 2] of a point `away` [T, 2] from the origin of a link whose pose has a covariance [T, 3, 3]."""
    carry = np.zeros((len(away), 2, 3))
    carry[:, 0, 0], carry[:, 1, 0] = -away[:, 1], away[:, 0]
    carry[:, 0, 1] = carry[:, 1, 2] = 1
    return np.einsum("tij,tjk,tlk->til", carry, covariance, carry)


def align_all(
    aligner: Aligner, frames: NDArray[np.intp], guess: Array, orbit: Array, anchor: Array, aside: float,
    advance: Advance | None,
) -> Poses:  # fmt: skip
    """Align a part to frames, from the best of a guess, of what the frames before let expect, and of its orbit.

    Args:
        aligner: of the part.
        frames: [n], indices.
        guess: [T, 3], poses.
        orbit: [m, 3], poses all around what it hangs on, if that is at (0, 0).
        anchor: [T, 2], where that is.
        aside: rad, by which a part may be turned otherwise than in the guess.
        advance: a progress bar, two steps per frame.
    """
    count = len(guess)
    values = np.full((count, 3), np.nan)
    covariance, seen = np.full((count, 3, 3), np.nan), np.zeros(count)
    misfit, size = np.full(count, np.inf), np.full(count, np.inf)
    trail: list[Array] = []
    for t in frames:
        near = orbit[np.abs(np.angle(np.exp(1j * (orbit[:, 0] - guess[t, 0])))) <= aside]
        starts = [guess[t], aligner.search(t, near + np.array([0, *anchor[t]]))]
        if len(frames) == count and trail:
            starts.append(np.array([guess[t, 0], *trail[-1][1:]]))
            starts += [np.array([guess[t, 0], *(2 * trail[-1] - trail[-2])[1:]])] if len(trail) > 1 else []
        start = min(starts, key=lambda p: aligner.cost(t, p))
        values[t], covariance[t], misfit[t], size[t], seen[t] = aligner.align(t, start, start[0])
        trail = [*trail[-1:], values[t]]
        if advance is not None:
            advance(2)
    return Poses(values, covariance, misfit, size, seen)


def _check_moved(film: Film, parts: list[Part]) -> None:
    """Refuse parts that hardly move: what was taken for one is noise, or light.

    Raises:
        InputError: if the places of one lie closer than `LEAST_WAY`.
    """
    for part in parts:
        where = part.places(part.keypoint)[0][part.seen]
        way = float(np.hypot(*np.ptp(where, axis=0)))
        if way < LEAST_WAY:
            raise InputError(
                f"{film.path}: what could be followed moves by {way * film.scale:.1f} pixels only; film a mechanism "
                "that swings, all of it, and nothing before it."
            )


def _learn_from(picture: NDArray[np.uint8], known: NDArray[np.intp]) -> NDArray[np.intp]:
    """Frames that differ much, among those in which the part was seen."""
    return known[diverse_frames(picture[known], LEARN)] if len(known) > LEARN else known


def _good(poses: Poses, *, strict: bool) -> NDArray[np.bool_]:
    """Frames in which the part was found: enough of it is seen, and it looks as it does elsewhere.

    Args:
        poses: in some frames.
        strict: a part that differs all over, by more than it does in most frames, counts as seen in part. Where looks
            are learned it counts in full: else they would not be learned in all lights.
    """
    known = np.isfinite(poses.values[:, 0])
    usual = float(np.median(poses.misfit[known & np.isfinite(poses.misfit)]))
    seen = poses.seen / poses.size**2 if strict else poses.seen
    return known & (seen > SEEN) & (poses.misfit < OTHER * max(usual, 0.5))


def _hinge(poses: Array, anchor: Array) -> Array:
    """What a part hangs on, in its own coordinates, [2]."""
    return np.median(np.einsum("tij,tj->ti", turn(-poses[:, 0]), anchor - poses[:, 1:]), axis=0)


def _orbit(hinge: Array, thickness: float) -> Array:
    """Poses all around what a part hangs on, half a thickness from one to the next, [m, 3]."""
    number = int(np.clip(4 * np.pi * np.linalg.norm(hinge) / max(thickness, 1.0), 24, 600))
    turns = np.arange(number) * 2 * np.pi / number
    return np.column_stack([turns, -turn(turns) @ hinge])


def _redo(poses: Array, part: Part, anchor: Array) -> Array:
    """Poses of all frames: places where the part was found, turned as they lie about its anchor; turns between them."""
    use = np.flatnonzero(part.seen)
    away = part.poses.values[use, 1:] - anchor[use]
    angles = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    zero = np.angle(np.mean(np.exp(1j * (angles - poses[use, 0]))))
    # whole turns between frames in use are those of the earlier poses
    angles += 2 * np.pi * np.round((poses[use, 0] + zero - angles) / (2 * np.pi))
    redone = poses.copy()
    redone[:, 0] += np.interp(np.arange(len(poses)), use, angles - zero - poses[use, 0])
    hinge = _hinge(np.column_stack([redone[use, 0], part.poses.values[use, 1:]]), anchor[use])
    redone[:, 1:] = anchor - turn(redone[:, 0]) @ hinge
    redone[use, 1:] = part.poses.values[use, 1:]
    return redone
