"""A declaration for an MJCF document, as far as the document tells: what `keycld new --mjcf` writes."""

import copy
import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.mjcf import check_document, refused
from keycld_envs.projection import world_to_image

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
LONG = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
SLIDE_RANGE = 0.5
"""m to both sides, of a slide joint without limits."""
INSIDE = 0.5
"""Share of a limited joint's range, about its middle, in which recordings start; world models know no end stops."""
STEP = 0.01
"""Seconds from frame to frame, or the nearest multiple of the document's time step."""
DAMPING, SETTLING = 3.0, 30.0
"""1/s, of every joint as a multiple of its inertia, and seconds, in which the mechanism comes to rest."""
SAME = 1e-3
"""m; anchors closer than that are at one place."""


@dataclass
class _Proposal:
    """What is put together while going through the bodies."""

    landmarks: list[str] = field(default_factory=list)
    rods: list[str] = field(default_factory=list)
    sliders: list[str] = field(default_factory=list)
    pivot: tuple[float, float] | None = None
    keypoint_of: dict[int, int] = field(default_factory=dict)


def proposal(mjcf: Path, beside: Path) -> str:
    """The text of a Python file that declares a system for an MJCF file, to be checked and changed.

    One keypoint for each body that moves: where the next link begins, or at the far end of the last one. A rod for each
    hinge, a slider for each slide joint on the ground.

    Args:
        mjcf: the document.
        beside: where the text will stand; the document's path is written relative to it.

    Raises:
        InputError: if it does not compile, or has no joint, an unnamed one, or no camera.
    """
    check_document(mjcf)
    try:
        model = mujoco.MjModel.from_xml_path(str(mjcf))
    except ValueError as error:
        raise refused(str(mjcf), error) from error
    _check(mjcf, model)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera, found = _camera(model, data), _Proposal()
    for body in range(1, model.nbody):
        if model.body_jntnum[body]:
            _add(model, data, camera, body, found)
    return _text(model, camera, found, os.path.relpath(mjcf.resolve(), beside.resolve().parent))


def _check(mjcf: Path, model: mujoco.MjModel) -> None:
    if not model.njnt or not np.isin(model.jnt_type, (HINGE, SLIDE)).all():
        raise InputError(f"{mjcf} must have hinge and slide joints, and no others; give each body that moves one.")
    for i in range(model.njnt):
        if not model.joint(i).name:
            raise InputError(f'{mjcf}: joint {i} has no name; write <joint name="..."/>.')
    for i in range(model.nu):
        if not model.actuator(i).name:
            raise InputError(f'{mjcf}: actuator {i} has no name; write <motor name="..."/>.')
    for body in range(1, model.nbody):
        if model.body_jntnum[body] and not model.body(body).name:
            raise InputError(f'{mjcf}: a body with a joint has no name; write <body name="...">.')
    if not any(model.camera(i).name for i in range(model.ncam)):
        raise InputError(
            f"{mjcf} has no camera with a name; write one that looks along the joints' axis into <worldbody>, "
            'such as <camera name="front" pos="0 -5 0" zaxis="0 -1 0"/>.'
        )


def _camera(model: mujoco.MjModel, data: mujoco.MjData) -> str:
    """The camera that looks most nearly along the hinges, or across the slides."""
    axes = data.xaxis[model.jnt_type == HINGE]
    views = data.cam_xmat.reshape(-1, 3, 3)[:, :, 2]
    named = [i for i in range(model.ncam) if model.camera(i).name]
    if not len(axes):
        return model.camera(min(named, key=lambda i: np.abs(data.xaxis @ views[i]).max())).name
    return model.camera(max(named, key=lambda i: np.abs(axes @ views[i]).min())).name


def _add(model: mujoco.MjModel, data: mujoco.MjData, camera: str, body: int, found: _Proposal) -> None:
    """Keypoint and constraints of one body."""
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    hinges = [j for j in joints if model.jnt_type[j] == HINGE]
    anchor = data.xanchor[joints[-1]]
    following = _next_joints(model, data, body)
    position = _far(model, data, body, anchor) if hinges else [*following, anchor][0]
    k, parent = len(found.landmarks), found.keypoint_of.get(_moving_parent(model, body))
    local = data.xmat[body].reshape(3, 3).T @ (position - data.xpos[body])
    found.landmarks.append(f"Landmark({model.body(body).name!r}, {_numbers(local)})")
    found.keypoint_of[body] = k
    if parent is None and found.pivot is None:
        x, y = world_to_image(model, data, anchor, camera, 64, 64)
        found.pivot = (float(x), float(y))
    if hinges and len(joints) == 1:
        found.rods.append(f"Rod({parent}, {k})")
    elif not hinges and len(joints) == 1 and parent is None:
        ends = np.array([anchor, anchor + 0.1 * data.xaxis[joints[0]]])
        along = np.diff(world_to_image(model, data, ends, camera, 64, 64), axis=0)[0]
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        found.sliders.append(f"Slider({k}, normal={_numbers(normal)})")


def _moving_parent(model: mujoco.MjModel, body: int) -> int:
    """The nearest body towards the ground that has a joint; 0 if there is none."""
    parent = int(model.body_parentid[body])
    while parent and not model.body_jntnum[parent]:
        parent = int(model.body_parentid[parent])
    return parent


def _next_joints(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> list[NDArray[np.float64]]:
    """Where links are joined to a body, [3] each, m."""
    children = [c for c in range(1, model.nbody) if model.body_jntnum[c] and _moving_parent(model, c) == body]
    return [data.xanchor[model.body_jntadr[child]].copy() for child in children]


def _far(model: mujoco.MjModel, data: mujoco.MjData, body: int, anchor: NDArray[np.float64]) -> NDArray[np.float64]:
    """[3] where the next link is joined, or the end of the geometry that is farthest from the joint, m."""
    for joint in _next_joints(model, data, body):
        if np.linalg.norm(joint - anchor) > SAME:
            return joint
    ends = [data.xipos[body]]
    for geom in np.flatnonzero(model.geom_bodyid == body):
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        half = axis * model.geom_size[geom, 1] * (int(model.geom_type[geom]) in LONG)
        ends += [data.geom_xpos[geom] + half, data.geom_xpos[geom] - half]
    return max(ends, key=lambda end: float(np.linalg.norm(end - anchor))).copy()


def _rest(model: mujoco.MjModel) -> NDArray[np.float64]:
    """[nq] where the mechanism comes to rest when it is damped, rad or m."""
    damped, data = copy.copy(model), mujoco.MjData(model)
    damped.dof_damping[:] = DAMPING * model.dof_M0
    damped.dof_frictionloss[:] = 0.0  # it would come to rest anywhere
    damped.opt.timestep = min(damped.opt.timestep, 0.005)
    data.qpos[:] = np.where(model.jnt_type == HINGE, 0.5, 0.0)
    for _ in range(round(SETTLING / damped.opt.timestep)):
        mujoco.mj_step(damped, data)
    rest = data.qpos.round(4)
    return np.where((model.jnt_type == HINGE) & (np.abs(np.abs(rest) - math.pi) < 0.01), math.pi, rest)


def _numbers(values: NDArray[np.float64] | tuple[float, ...]) -> str:
    """Numbers as they are written in Python."""
    numbers = [f"{round(float(v), 4) + 0.0:g}" for v in values]
    return f"({', '.join(numbers)}{',' * (len(numbers) == 1)})"


def _text(model: mujoco.MjModel, camera: str, found: _Proposal, mjcf: str) -> str:
    joints = []
    for i in range(model.njnt):
        hinge = model.jnt_type[i] == HINGE
        bounds = (
            tuple(model.jnt_range[i].mean() + INSIDE / 2 * np.diff(model.jnt_range[i])[0] * np.array([-1, 1]))
            if model.jnt_limited[i]
            else (-math.pi, math.pi)
            if hinge
            else (-SLIDE_RANGE, SLIDE_RANGE)
        )
        joints.append(f"Joint({model.joint(i).name!r}, {'hinge' if hinge else 'slide'!r}, {_numbers(bounds)})")
    actuators = "".join(f"{model.actuator(i).name!r}, " for i in range(model.nu))
    rest = _rest(model)
    target = tuple(0.0 if kind == HINGE else at for kind, at in zip(model.jnt_type, rest, strict=True))
    step = model.opt.timestep * max(1, round(STEP / model.opt.timestep))
    rods, sliders, landmarks = (", ".join([*each, ""]) for each in (found.rods, found.sliders, found.landmarks))
    return f'''"""A mechanism of {mjcf}; `keycld check` says what does not fit."""

from pathlib import Path

from keycld_envs import Joint, Landmark, Mechanism, Rod, Slider, System

system = System(
    name=Path(__file__).stem,
    # The simulation; the path is relative to this file.
    mjcf=Path({mjcf!r}),
    # Every joint of the MJCF, in its order: name, kind, and where recordings start (rad for "hinge", m for "slide").
    joints=({", ".join([*joints, ""]).strip()}),
    # Every actuator of the MJCF, in its order.
    actuators=({actuators.strip()}),
    # What the world model knows: keypoints and what holds them. A rod from None starts at the pivot, in image units:
    # (0, 0) is the middle, 1 the right or upper border. Lengths are learned.
    mechanism=Mechanism(
        num_keypoints={len(found.landmarks)},
        num_actions={model.nu},
        rods=({rods.strip()}),
        sliders=({sliders.strip()}),
        pivot={_numbers(found.pivot or (0.0, 0.0))},
    ),
    # Where keypoints truly are: a body of the MJCF, and the position on it, in m. For measuring only.
    landmarks=({landmarks.strip()}),
    camera={camera!r},
    # Seconds from frame to frame, and from action to action.
    timestep={step:.6g},
    # Where to go, and where it hangs still: one number per joint, rad or m.
    target_qpos={_numbers(target)},
    hanging_qpos={_numbers(rest)},
)
'''
