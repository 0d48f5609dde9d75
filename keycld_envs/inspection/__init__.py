"""Is a mechanism declared as it is simulated and seen? What `keycld check` finds before anything is recorded."""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from keycld_envs.inspection import camera, constraints, motion
from keycld_envs.inspection.constraints import Value
from keycld_envs.inspection.motion import Actuator, Speed
from keycld_envs.inspection.poses import Poses
from keycld_envs.systems import System

POSES = 200
MOST_TURNS = 2.0
"""Turns either way beyond which angles are degrees."""
LEANING = 0.01
"""rad or m by which a mechanism that rests against the end of a joint's range presses into it."""
TOUCHING = 0.05
"""Fraction of random poses in which bodies may touch before it is said that no model here knows contact."""


@dataclass(frozen=True)
class Inspection:
    """What was found.

    Attributes:
        poses: what was looked at.
        constraints: rods and sliders over all poses.
        in_view: [K] fraction of random poses in which each keypoint is in the image.
        actuators: what each does.
        speed: of episodes as they are recorded by default; None if problems came first.
        problems: what has to be mended, a sentence each.
        warnings: what to mind when recording, a sentence each.
    """

    poses: Poses
    constraints: tuple[Value, ...]
    in_view: tuple[float, ...]
    actuators: tuple[Actuator, ...] = ()
    speed: Speed | None = None
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = field(default=())


def inspect(system: System, seed: int = 0) -> Inspection:
    """Move a system through random poses and short runs, and compare what it does with what is declared.

    What follows from another problem is not reported: motion is looked at when geometry is right.

    Args:
        system: the declaration.
        seed: of poses and runs.

    Raises:
        InputError: if it does not compile, or the simulation diverges.
    """
    model = system.compile()
    poses = Poses.of(system, model, POSES, seed)
    values = constraints.values(system.mechanism, poses.keypoints)
    seen = tuple(map(float, camera.in_view(poses)))
    wrong = (
        tuple(_degrees(system) or _ranges(system, model))
        or tuple(camera.problems(poses))
        or tuple(constraints.problems(poses))
    )
    if wrong:
        return Inspection(poses, values, seen, problems=wrong)
    actuators = motion.actuators(system, poses)
    wrong = tuple(motion.problems(system, poses, actuators))
    usual = motion.speed(system, seed)
    minded = (*motion.advice(system, seed, poses, usual), *camera.advice(poses), *_contacts(poses))
    if not wrong:
        minded += tuple(motion.without_task(system))
    return Inspection(poses, values, seen, actuators, usual, wrong, minded)


def _ranges(system: System, model: mujoco.MjModel) -> list[str]:
    """Starts and targets outside the range of their joints."""
    found = []
    for i in np.flatnonzero(model.jnt_limited):
        low, high = model.jnt_range[i]
        for name, numbers in _declared(system, int(i)):
            beyond = LEANING if name == "hanging_qpos" else 1e-9
            if min(numbers) < low - beyond or max(numbers) > high + beyond:
                degrees = ', in which degrees are meant unless it has <compiler angle="radian"/>'
                found.append(
                    f"{name} of joint {system.joints[i].name!r} lies outside its range in the MJCF, {low:.3g} to "
                    f"{high:.3g}{degrees if system.joints[i].kind == 'hinge' else ''}; change one of them."
                )
    return found[:1]


def _degrees(system: System) -> list[str]:
    """Angles that are many turns, so that they are degrees."""
    found = [
        f"{name} of joint {joint.name!r} has {max(numbers, key=abs):g} rad, which is many turns; write radians, "
        "math.radians(...)."
        for i, joint in enumerate(system.joints)
        if joint.kind == "hinge"
        for name, numbers in _declared(system, i)
        if max(map(abs, numbers)) > 2 * np.pi * MOST_TURNS
    ]
    return found[:1]


def _declared(system: System, i: int) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """Names and values of what is declared for one joint."""
    return (
        ("start_range", system.joints[i].start_range),
        ("target_qpos", system.target_qpos[i : i + 1]),
        ("hanging_qpos", system.hanging_qpos[i : i + 1]),
    )


def _contacts(poses: Poses) -> list[str]:
    """Bodies that touch, which no world model knows of."""
    model, data, touching = poses.model, mujoco.MjData(poses.model), []
    for qpos in poses.qpos:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        touching.append([tuple(model.geom_bodyid[c.geom]) for c in data.contact[: data.ncon] if c.dist <= 0])
    often = np.mean([bool(pairs) for pairs in touching])
    if often <= TOUCHING:
        return []
    one, other = (model.body(int(b)).name for b in next(pairs[0] for pairs in touching if pairs))
    return [
        f"Bodies {one!r} and {other!r} touch in {100 * often:.0f} % of random poses, which no world model knows of; "
        'move them apart, or write <flag contact="disable"/> within <option>.'
    ]
