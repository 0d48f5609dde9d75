"""A base that swings to and fro."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class BaseMotion(Effect):
    """Everything hangs on a base that accelerates along the world's x or z axis."""

    id: ClassVar[str] = "base_motion"
    family: ClassVar[str] = "force"
    kind: ClassVar = "world"
    equation: ClassVar[str] = "tau = -J'*m*(a*sin(w*t) + b*cos(w*t))"

    a: float = parameter("m/s^2", 0.1)
    b: float = parameter("m/s^2", 0.1)
    w: float = parameter("rad/s", 0.05, low=0.5, grid=(2.0, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0))

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple["BaseMotion", ...]:
        """One per axis along which the base can feel its masses."""
        return tuple(cls(axis) for axis in ("x", "z"))

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """Inertia of all masses, as gravity would pull on them."""
        acceleration = self.a * np.sin(self.w * t) + self.b * np.cos(self.w * t)
        axis = {"x": 0, "z": 2}[self.where]
        return -acceleration[..., None] * weight(model, axis, q)


def weight(model: mujoco.MjModel, axis: int, q: Array) -> Array:
    """Generalised force `[..., nv]` of a unit of gravity along an axis of the world, at positions `[..., nq]`."""
    data, flat = mujoco.MjData(model), q.reshape(-1, q.shape[-1])
    out, jacobian = np.empty((len(flat), model.nv)), np.empty((3, model.nv))
    for row, position in zip(out, flat, strict=True):
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSubtreeCom(model, data, jacobian, 0)
        row[:] = model.body_subtreemass[0] * jacobian[axis]
    return out.reshape(*q.shape[:-1], model.nv)
