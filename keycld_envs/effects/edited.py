"""Models that effects have edited, and what their numbers do."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from keycld_envs.constants import update_constants
from keycld_envs.effects.base import Array, Effect
from keycld_envs.effects.functions import smooth_sign


def edited(model: mujoco.MjModel, effects: Sequence[Effect]) -> mujoco.MjModel:
    """A copy of a compiled model with the numbers that effects change."""
    out = copy.copy(model)
    for effect in effects:
        effect.edit(out)
    update_constants(out)
    return out


def resistance(before: mujoco.MjModel, after: mujoco.MjModel, v: Array) -> Array:
    """Force against the motion that one model has beyond another, `[..., nv]`, N m or N, at velocities `[..., nv]`."""
    names = ("dof_damping", "dof_dampingpoly", "dof_frictionloss")
    damping, polynomial, friction = (np.asarray(getattr(after, n) - getattr(before, n)) for n in names)
    out = -damping * v - friction * smooth_sign(v)
    for power, coefficient in enumerate(polynomial.T, start=1):
        out -= coefficient * v * np.abs(v) ** power
    return out


def torque_per_command(model: mujoco.MjModel) -> Array:
    """Torque at each joint for a unit of each command, `[nv, nu]`, of motors whose torque is linear in it."""
    out = np.zeros((model.nv, model.nu))
    for i in range(model.nu):
        if (
            model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
            and model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE
        ):
            dof = int(model.jnt_dofadr[model.actuator_trnid[i, 0]])
            out[dof, i] = model.actuator_gear[i, 0] * model.actuator_gainprm[i, 0]
    return out


def moments(model: mujoco.MjModel, qpos: ArrayLike) -> Array:
    """Torque at each joint for a unit of each actuator's force, `[nu, nv]`, through joints, tendons or whatever else.

    Args:
        model: the simulator.
        qpos: `[nq]` where it is, rad or m.
    """
    data, out = mujoco.MjData(model), np.zeros((model.nu, model.nv))
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    mujoco.mju_sparse2dense(
        out, data.actuator_moment.ravel(), data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return out


def actuator_torque(model: mujoco.MjModel, i: int, q: Array, v: Array, u: Array) -> Array:
    """Torque of actuator i at its joint, `[...]`, at its positions and velocities `[...]`, for commands `[..., nu]`."""
    gear, (b0, b1, b2) = model.actuator_gear[i, 0], model.actuator_biasprm[i, :3]
    told = np.clip(u[..., i], *model.actuator_ctrlrange[i]) if model.actuator_ctrllimited[i] else u[..., i]
    torque = model.actuator_gainprm[i, 0] * told + b0 + gear * (b1 * q + b2 * v)
    return gear * (np.clip(torque, *model.actuator_forcerange[i]) if model.actuator_forcelimited[i] else torque)
