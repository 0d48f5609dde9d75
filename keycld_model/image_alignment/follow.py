"""Poses of all frames of a recording, one after the other."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.fit_look import UNSEEN, find_pose
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import TRUSTED, Pose, align, align_again, nothing_moves
from keycld_model.image_alignment.scene import Scene
from keycld_model.turns import nearest_turn

Array = NDArray[np.float64]
Image = NDArray[np.float32]
WORSE = 3.0
"""A misfit, or a share of the motion that is left, of so many times the usual one is looked at again from elsewhere."""
LEFT = 0.1
"""Share of the motion that any pose may leave: edges drawn in a few shades leave some."""
AGAIN = 2
"""Times that poses are fitted again from those around; errors are then half as large, and a third time takes little
off."""
AROUND, DEGREE = 3, 3
"""Frames before and after one, and the degree of the polynomial in time, that tell where to begin."""
FAR = 2.0
"""Robust standard deviations; poses so far from where those around lead to are fitted twice more, from elsewhere."""
ELSEWHERE = (0.5, -0.5)
"""Beyond where those around lead to, shares of the way from a pose to there."""
AT_SPEED = 3
"""Frames for which a mechanism goes on as fast as it was while it is not read; swings turn back after longer, and would
be taken for whole turns."""


def follow(
    scene: Scene,
    look: Array,
    light: Light,
    times: Array,
    frames: NDArray[np.uint8],
    bank: Bank,
) -> list[Pose]:
    """Poses of consecutive frames; each begins where the last three that explained theirs lead to.

    Hinges turn on beyond a full turn, as they do. Where nothing is seen, the last pose stays.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        times: `[T]` of the frames, s.
        frames: `[T, H, W, 3]`.
        bank: drawings of the scene.
    """
    still, turn = light.apply(bank.still), turning(scene.model)
    poses: list[Pose] = []
    seen: list[Pose] = []
    for k, raw in enumerate(frames):
        frame = raw.astype(np.float32)
        if poses and nothing_moves(frame, still):
            poses.append(replace(poses[-1], explained=0.0, empty=True))
            continue
        guess = _continued(times[: k + 1], poses)
        pose = None if guess is None else align(scene, look, light, frame, still, guess, near=True, finely=False)
        if pose is None or k < 2 or pose.explained < UNSEEN or _unusual(pose, seen[-50:]):
            other = find_pose(scene, look, light, frame, bank, still)
            pose = other if pose is None or other.explained > pose.explained + 0.02 else pose
        near = guess if guess is not None else np.zeros_like(pose.q)
        seen.append(replace(pose, q=nearest_turn(pose.q, near, turn)))
        poses.append(seen[-1])
    for beyond in (*[0.0] * AGAIN, *ELSEWHERE):
        poses = _again(scene, look, light, times, frames, still, poses, beyond)
    return poses


def _again(
    scene: Scene,
    look: Array,
    light: Light,
    times: Array,
    frames: NDArray[np.uint8],
    still: Image,
    poses: Sequence[Pose],
    beyond: float,
) -> list[Pose]:
    """Poses that begin from where those around lead to, or beyond, or the old ones, where these leave less of a frame.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        times: `[T]` of the frames, s.
        frames: `[T, H, W, 3]`.
        still: what the recording shows where nothing moves.
        poses: of the frames.
        beyond: share of the way to there; if it is not 0, poses that are near stay.
    """
    known = [k for k, pose in enumerate(poses) if pose.readable]
    out, turn = list(poses), turning(scene.model)
    if not known:
        return out
    q = np.array([poses[k].q for k in known])
    way = _led_to(times[known], q) - q
    far = (np.abs(way) > FAR * 1.4826 * np.median(np.abs(way), axis=0)).any(axis=1)
    usual = np.median([poses[k].left for k in known])
    for i in np.flatnonzero(far) if beyond else range(len(known)):
        old, frame = poses[known[i]], frames[known[i]].astype(np.float32)
        pose = align_again(scene, look, light, frame, still, q[i] + (1 + beyond) * way[i], old)
        if pose.left > WORSE * usual:
            pose = min(pose, align(scene, look, light, frame, still, pose.q, near=True), key=lambda each: each.left)
        out[known[i]] = replace(pose, q=nearest_turn(pose.q, old.q, turn))
    return out


def _led_to(times: Array, q: Array) -> Array:
    """Where the poses around lead to at each time, `[T, nq]`; where they are, if they are too few."""
    out = q.copy()
    for k in range(len(q) if len(q) > 2 * AROUND else 0):
        first = min(max(0, k - AROUND), len(q) - 2 * AROUND - 1)
        around = [j for j in range(first, first + 2 * AROUND + 1) if j != k]
        out[k] = np.polynomial.polynomial.polyfit(times[around] - times[k], q[around], DEGREE)[0]
    return out


def turning(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """`[nq]` whether a joint looks the same after a full turn."""
    return (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & ~model.jnt_limited.astype(bool)


def _unusual(pose: Pose, before: Sequence[Pose]) -> bool:
    """Whether it leaves far more of pixels, grey levels, or of what moves, a share, than those before."""
    misfit, explained = np.median([(other.misfit, other.explained) for other in before], axis=0)
    return pose.misfit > WORSE * misfit or 1 - pose.explained > max(LEFT, WORSE * (1 - explained))


def _continued(times: Array, poses: Sequence[Pose]) -> Array | None:
    """Where the last poses that explained their frames lead to at the last of the times; None at the beginning.

    At constant acceleration from three frames that follow each other up to it; otherwise at constant speed, or, after
    longer, where the last one was.
    """
    if not poses:
        return None
    told = (k for k in reversed(range(len(poses))) if poses[k].explained >= TRUSTED)
    known = list(itertools.islice(told, 3)) or [len(poses) - 1]
    if len(poses) - known[-1] > 3:
        known = known[: 2 if len(poses) - known[0] <= AT_SPEED else 1]
    q = np.stack([poses[k].q for k in known])
    return np.polynomial.polynomial.polyfit(times[known] - times[-1], q, len(known) - 1)[0]
