"""Poses of all frames of a recording, one after the other."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.fit_look import UNSEEN, find_pose
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import Pose, align, nothing_moves
from keycld_model.image_alignment.scene import Scene
from keycld_model.turns import nearest_turn

Array = NDArray[np.float64]
Image = NDArray[np.float32]
WORSE = 3.0
"""A misfit of so many times the usual one is looked at again from elsewhere."""


def follow(
    scene: Scene,
    look: Array,
    light: Light,
    times: Array,
    frames: NDArray[np.uint8],
    bank: Bank,
) -> list[Pose]:
    """Poses of consecutive frames; each begins where the last three lead to.

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
    misfits: list[float] = []
    for k, raw in enumerate(frames):
        frame = raw.astype(np.float32)
        if poses and nothing_moves(frame, still):
            poses.append(replace(poses[-1], explained=0.0, empty=True))
            continue
        guess = _continued(times[: k + 1], poses)
        pose = None if guess is None else align(scene, look, light, frame, still, guess, near=True)
        usual = float(np.median(misfits[-50:])) if misfits else np.inf
        if pose is None or k < 2 or pose.explained < UNSEEN or pose.misfit > WORSE * usual:
            other = find_pose(scene, look, light, frame, bank, still)
            pose = other if pose is None or other.explained > pose.explained + 0.02 else pose
        near = guess if guess is not None else np.zeros_like(pose.q)
        poses.append(replace(pose, q=nearest_turn(pose.q, near, turn)))
        misfits.append(pose.misfit)
    return poses


def turning(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """`[nq]` whether a joint looks the same after a full turn."""
    return (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & ~model.jnt_limited.astype(bool)


def _continued(times: Array, poses: Sequence[Pose]) -> Array | None:
    """Where the last poses lead to at the last of the times; None at the beginning."""
    known = min(3, len(poses))
    if known == 0:
        return None
    t = times[-known - 1 :] - times[-1]
    q = np.stack([pose.q for pose in poses[-known:]])
    return np.polynomial.polynomial.polyfit(t[:-1], q, known - 1)[0]
