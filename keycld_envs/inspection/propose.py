"""A declaration for an MJCF document, as far as the document tells: what `keycld new --mjcf` writes."""

import copy
import math
import os
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.inspection.tree import HINGE, SLIDE, Tree
from keycld_envs.mjcf import check_document, refused

SLIDE_RANGE = 0.5
"""m to both sides, of a slide joint without limits."""
INSIDE = 0.5
"""Share of a limited joint's range, about its middle, in which recordings start; world models know no end stops."""
STEP = 0.01
"""Seconds from frame to frame, or the nearest multiple of the document's time step."""
DAMPING, SETTLING = 3.0, 30.0
"""1/s, of every joint as a multiple of its inertia, and seconds, in which the mechanism comes to rest."""
DIGITS, ROUNDING = 5, 1e-5
"""Of the numbers that are written, after the point; and what that may leave out."""
NEAR = 0.01
"""rad; angles that differ by less are the same for the one who swings something up."""


def proposal(mjcf: Path, beside: Path) -> str:
    """The text of a Python file that declares a system for an MJCF file, to be checked and changed.

    One keypoint for each body that moves, where the next link begins, or at the far end of the last one, and one more
    for each other place where links are joined. A rod for each hinge, a slider for each slide joint on the ground.

    Args:
        mjcf: the document.
        beside: where the text will stand; the document's path is written relative to it.

    Raises:
        InputError: if it does not compile, has no joint, an unnamed one, or no camera, or if rods and sliders cannot
            say how its bodies move.
    """
    check_document(mjcf)
    try:
        model = mujoco.MjModel.from_xml_path(str(mjcf))
    except ValueError as error:
        raise refused(str(mjcf), error) from error
    _check(mjcf, model)
    try:
        tree = Tree.of(model, _camera(model))
    except InputError as error:
        raise InputError(f"{mjcf}: {error}") from error
    return _text(tree, os.path.relpath(mjcf.resolve(), beside.resolve().parent))


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


def _camera(model: mujoco.MjModel) -> str:
    """The camera that looks most nearly along the hinges, or across the slides."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    axes = data.xaxis[model.jnt_type == HINGE]
    views = data.cam_xmat.reshape(-1, 3, 3)[:, :, 2]
    named = [i for i in range(model.ncam) if model.camera(i).name]
    if not len(axes):
        return model.camera(min(named, key=lambda i: np.abs(data.xaxis @ views[i]).max())).name
    return model.camera(max(named, key=lambda i: np.abs(axes @ views[i]).min())).name


def _rest(model: mujoco.MjModel) -> NDArray[np.float64]:
    """[nq] where the mechanism comes to rest when it is damped, rad or m."""
    damped, data = copy.copy(model), mujoco.MjData(model)
    damped.dof_damping[:] = DAMPING * model.dof_M0
    damped.dof_frictionloss[:] = 0.0  # it would come to rest anywhere
    damped.opt.timestep = min(damped.opt.timestep, 0.005)
    data.qpos[:] = np.where(model.jnt_type == HINGE, 0.5, 0.0)
    for _ in range(round(SETTLING / damped.opt.timestep)):
        mujoco.mj_step(damped, data)
    rest = data.qpos.round(DIGITS)
    return np.where((model.jnt_type == HINGE) & (np.abs(np.abs(rest) - math.pi) < NEAR), math.pi, rest)


def _target(model: mujoco.MjModel, rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """[nq] where to go, rad or m: hinges as they are drawn; if it hangs so, as high as they get.

    Hinges that cannot be as they are drawn are in the middle of their range.
    """
    hinges = model.jnt_type == HINGE
    low, high = model.jnt_range.T
    beyond = hinges & model.jnt_limited.astype(bool) & ((low > 0) | (high < 0))
    drawn = np.where(beyond, (low + high) / 2, np.where(hinges, 0.0, rest))
    if not hinges.any() or np.abs(drawn - rest)[hinges].max() > NEAR:
        return drawn
    upwards = copy.copy(model)
    upwards.opt.gravity[:] = -model.opt.gravity
    upwards.jnt_stiffness[:] = 0.0
    highest = np.where(hinges, _rest(upwards), rest)
    return np.where(model.jnt_limited, np.clip(highest, low + ROUNDING, high - ROUNDING), highest)


def _numbers(values: NDArray[np.float64] | Sequence[float]) -> str:
    """Numbers as they are written in Python."""
    numbers = [f"{round(float(v), DIGITS) + 0.0:g}" for v in values]
    return f"({', '.join(numbers)}{',' * (len(numbers) == 1)})"


def _text(tree: Tree, mjcf: str) -> str:
    model, joints = tree.model, []
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
    step = model.opt.timestep * max(1, round(STEP / model.opt.timestep))
    rods = "".join(f"Rod({rod.start}, {rod.end}), " for rod in tree.rods)
    sliders = "".join(f"Slider({s.keypoint}, normal={_numbers(s.normal)}), " for s in tree.sliders)
    landmarks = "".join(f"Landmark({each.body!r}, {_numbers(each.position)}), " for each in tree.landmarks)
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
        num_keypoints={len(tree.landmarks)},
        num_actions={model.nu},
        rods=({rods.strip()}),
        sliders=({sliders.strip()}),
        pivot={_numbers(tree.pivot)},
    ),
    # Where keypoints truly are: a body of the MJCF, and the position on it, in m. For measuring only.
    landmarks=({landmarks.strip()}),
    camera={tree.camera!r},
    # Seconds from frame to frame, and from action to action.
    timestep={step:.6g},
    # Where to go, and where it hangs still: one number per joint, rad or m.
    target_qpos={_numbers(_target(model, rest))},
    hanging_qpos={_numbers(rest)},
)
'''
