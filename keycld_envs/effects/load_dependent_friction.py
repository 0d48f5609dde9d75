"""Dry friction of a bearing that carries a load."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Confusable, parameter
from keycld_envs.effects.functions import smooth_sign
from keycld_envs.effects.places import JointEffect, flat


@dataclass(frozen=True)
class LoadDependentFriction(JointEffect):
    """Friction in proportion to the force N in the bearing; of a slide, its part across the rail.

    N is that of the motion without this friction. Of a hinge, mu includes the radius of the pin.
    """

    id: ClassVar[str] = "load_dependent_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -mu*|N|*sign(qd)"
    program: ClassVar[str | None] = "load"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"mu": 0.1}, on_rails=True)
    """A bearing is thought to carry 10 N."""

    mu: float = parameter("m or 1", 0.002, low=0.0)

    def dry_friction(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """In proportion to the load."""
        return self.mu * load()

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The same against the motion."""
        dof, out = self.dof(model), np.zeros_like(v)
        if self.mu > 0:
            out[..., dof] = -self.mu * bearing_force(model, self.where, q, v, u) * smooth_sign(v[..., dof])
        return out


def bearing_force(model: mujoco.MjModel, where: str, q: Array, v: Array, u: Array) -> Array:
    """Force in a joint's bearing, N, `[...]`; of a slide, its part across the rail. Other arguments: see `Effect`."""
    joint = model.joint(where)
    body, slides = int(joint.bodyid[0]), joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    data, shape = mujoco.MjData(model), v.shape[:-1]
    rows = zip(*(flat(x) for x in (q, v, u)), strict=True)
    out = []
    for position, velocity, command in rows:
        data.qpos[:], data.qvel[:], data.ctrl[:] = position, velocity, command
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        load = data.cfrc_int[body, 3:].copy()
        if slides:
            axis = data.xaxis[joint.id]
            load -= axis * (axis @ load)
        out.append(np.linalg.norm(load))
    return np.array(out).reshape(shape)
