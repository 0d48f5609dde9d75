"""Whether the camera sees the keypoints, from in front, and at right angles to the plane of motion."""

from collections.abc import Callable, Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.inspection.poses import PIXEL, SIDE, Poses
from keycld_envs.projection import focal_length

IN_VIEW = 0.95
"""Fraction of random poses in which each keypoint has to be in the image."""
FLAT = 0.02
"""Of the distance to the camera, by which a keypoint may move towards it."""
STILL = 0.5 * PIXEL
"""Image units; what moves less over random poses stays where it is."""
SMALLEST = 4 * PIXEL
"""Image units that a mechanism has to take up; of a smaller one, a rod from the middle to the rim is lost in pixels."""
FITTING = 1.0
"""Image units, half the width of the image, that a mechanism may well take up."""
HIDDEN = 0.3
"""Of what is seen of a body in usual poses, below which it is hidden."""
LOOKED_AT = 30
"""Random poses that are usual."""
VISIBLE = 12
"""Levels of 255 by which some pixel has to change between poses."""
NOTICEABLE = PIXEL
"""Image units by which a joint has to move some keypoint before its motion has to be seen."""
TRIES = 8
"""Random poses from which a joint is moved alone; in some of them, links may hide each other."""


def in_view(poses: Poses) -> NDArray[np.float64]:
    """[K] fraction of the random poses in which each keypoint is in the image."""
    return ((np.abs(poses.keypoints[:-2]) <= 1).all(axis=2) & (poses.depths[:-2] > 0)).mean(axis=0)


def problems(poses: Poses) -> Iterator[str]:
    """What is wrong with camera and landmarks, a sentence each."""
    system, name = poses.system, poses.system.camera
    if behind := [int(k) for k in np.flatnonzero((poses.depths <= 0).any(axis=0))]:
        yield f"{poses.named(behind[0]).capitalize()} is behind the camera {name!r}; turn the camera, or move it back."
        return
    if (size := _size(poses)) < SMALLEST:
        near = poses.depths.mean() * size / FITTING
        yield (
            f"The camera {name!r} is too far away: the mechanism is {size / PIXEL:.1f} pixels large; move the camera "
            f"nearer, to about {near:.3g} m."
        )
        return
    far = np.ptp(poses.depths, axis=0) / poses.depths.mean(axis=0)
    if far.max() > FLAT:
        yield (
            f"{poses.named(int(far.argmax())).capitalize()} moves towards the camera {name!r} by "
            f"{np.ptp(poses.depths, axis=0).max():.2g} m; look along the normal of the plane of motion, "
            'for joints with axis="0 1 0" zaxis="0 -1 0".'
        )
        return
    still = [k for k in range(len(far)) if np.ptp(poses.keypoints[:, k], axis=0).max() < STILL]
    if still:
        yield (
            f"{poses.named(still[0]).capitalize()} never moves; put its landmark on a body that moves, away from its "
            "joint."
        )
        return
    yield from _outside(poses)
    yield from _coinciding(poses)
    mass = _hidden_mass(poses)
    if mass is not None:
        yield f"Body {mass!r} moves behind the camera {name!r} of system {system.name!r}; move the camera back."


def advice(poses: Poses) -> Iterator[str]:
    """What is hidden at the target, where an agent has to see it; a sentence each."""
    usual = np.median([_pixels(poses, qpos) for qpos in poses.qpos[:-2][:LOOKED_AT]], axis=0)
    there = _pixels(poses, poses.qpos[-2])
    for body in {poses.model.body(landmark.body).id for landmark in poses.system.landmarks}:
        if there[body] < HIDDEN * usual[body]:
            yield (
                f"At target_qpos, body {poses.model.body(body).name!r} is hidden: camera {poses.system.camera!r} sees "
                f"{there[body]} of the {usual[body]:.0f} pixels that it usually sees of it, and an agent needs to see "
                "it there; move its geoms nearer to the camera, or choose another target."
            )


def unseen_joints(poses: Poses, render: Callable[[NDArray[np.float64]], NDArray[np.uint8]]) -> list[int]:
    """Joints that move a keypoint, and nothing in images.

    Args:
        poses: what was looked at.
        render: image [H, W, 3] of joint positions [nq].
    """
    found = []
    for joint in range(poses.qpos.shape[1]):
        moved = poses.qpos[:TRIES].copy()
        moved[:, joint] = poses.qpos[1 : TRIES + 1, joint]
        far = np.abs(poses.keypoints_at(moved) - poses.keypoints[:TRIES]).max(axis=(1, 2)) > NOTICEABLE
        pairs = zip(poses.qpos[:TRIES][far], moved[far], strict=True)
        if far.any() and all(sees_nothing([render(one), render(other)]) for one, other in pairs):
            found.append(joint)
    return found


def _size(poses: Poses) -> float:
    """Of what keypoints reach and of what moves, whichever is larger, image units."""
    model = poses.model
    reach = np.ptp(poses.keypoints, axis=(0, 1)).max()
    widest = 2 * model.geom_rbound[model.body_weldid[model.geom_bodyid] > 0].max(initial=0.0)
    return float(max(reach, widest * focal_length(model, poses.system.camera, SIDE) / poses.depths.mean() * PIXEL))


def _pixels(poses: Poses, qpos: NDArray[np.float64]) -> NDArray[np.int64]:
    """[nbody] rays through the pixels of the camera that meet each body first."""
    model, data, camera = poses.model, mujoco.MjData(poses.model), poses.model.camera(poses.system.camera).id
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    across = np.tan(np.deg2rad(model.cam_fovy[camera]) / 2) * ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1)
    x, y = np.meshgrid(across, -across)
    rays = np.stack([x, y, -np.ones_like(x)], -1).reshape(-1, 3) @ data.cam_xmat[camera].reshape(3, 3).T
    geoms, far = np.full(len(rays), -1, np.int32), np.zeros(len(rays))
    start, directions = data.cam_xpos[camera], np.ascontiguousarray(rays).ravel()
    mujoco.mj_multiRay(model, data, start, directions, None, True, -1, geoms, far, None, len(rays), mujoco.mjMAXVAL)
    return np.bincount(model.geom_bodyid[geoms[geoms >= 0]], minlength=model.nbody)


def _outside(poses: Poses) -> Iterator[str]:
    """Keypoints that leave the image."""
    seen, name = in_view(poses), poses.system.camera
    reach = np.abs(poses.keypoints).max()
    if (seen == 0).all():
        yield f"The camera {name!r} sees no keypoint in any random pose; turn it towards the mechanism."
    elif seen.min() < IN_VIEW:
        yield (
            f"{poses.named(int(seen.argmin())).capitalize()} is out of the image of camera {name!r} in "
            f"{100 - 100 * seen.min():.0f} % of random poses; move the camera {reach:.1f} times as far away, or narrow "
            "start_range."
        )
    else:
        for pose, what in ((-2, "target_qpos"), (-1, "hanging_qpos")):
            if (np.abs(poses.keypoints[pose]) > 1).any():
                k = int(np.abs(poses.keypoints[pose]).max(axis=1).argmax())
                yield (
                    f"{poses.named(k).capitalize()} is out of the image at {what}; move the camera "
                    f"{np.abs(poses.keypoints[pose]).max():.1f} times as far away, or change {what}."
                )


def _coinciding(poses: Poses) -> Iterator[str]:
    """Two keypoints that are always at one place."""
    for one in range(poses.keypoints.shape[1]):
        for other in range(one):
            if np.abs(poses.keypoints[:, one] - poses.keypoints[:, other]).max() < STILL:
                yield (
                    f"Keypoints {other} and {one} are always at the same place; give the landmark of one another "
                    "position, or leave it out."
                )
                return


def _hidden_mass(poses: Poses) -> str | None:
    """A body with a mass that is behind the camera in some pose."""
    model, data = poses.model, mujoco.MjData(poses.model)
    camera = model.camera(poses.system.camera).id
    for qpos in poses.qpos[-32:]:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        depth = -(data.xipos - data.cam_xpos[camera]) @ data.cam_xmat[camera].reshape(3, 3)[:, 2]
        if hidden := [body for body in range(1, model.nbody) if model.body_mass[body] > 0 and depth[body] <= 0]:
            return model.body(hidden[0]).name
    return None


def sees_nothing(images: Sequence[NDArray[np.uint8]]) -> bool:
    """Whether images [H, W, 3] of different poses are alike."""
    return bool(np.ptp(np.stack(images), axis=0).max() < VISIBLE)
