"""A base that swings to and fro."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import EVERY, Array, Effect, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import FREQUENCIES


@dataclass(frozen=True)
class BaseMotion(Effect):
    """Everything hangs on a base that accelerates along the world's x or z axis; for hinges and slides."""

    id: ClassVar[str] = "base_motion"
    family: ClassVar[str] = "force"
    kind: ClassVar = "world"
    program: ClassVar[str | None] = EVERY
    equation: ClassVar[str] = "tau = -J'*m*(a*sin(w*t) + b*cos(w*t))"

    a: float = parameter("m/s^2", 0.1)
    b: float = parameter("m/s^2", 0.1)
    w: float = parameter("rad/s", 0.05, low=0.5, grid=FREQUENCIES, temporal=True)

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple["BaseMotion", ...]:
        """One per axis along which the base can feel its masses."""
        return tuple(cls(axis) for axis in ("x", "z"))

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """Inertia of all masses, as gravity would pull on them."""
        return -self.base_acceleration(t)[..., None] * weight(model, self.axis, q)

    def slot(self, model: mujoco.MjModel) -> tuple[int, int]:
        """Index of the axis."""
        return self.axis, -1

    @property
    def axis(self) -> int:
        """Index of the axis of the world along which the base moves."""
        return {"x": 0, "z": 2}[self.where]

    def base_acceleration(self, t: Array) -> Array:
        """Acceleration of the base at times, m/s^2."""
        xp = functions(t)
        return self.a * xp.sin(self.w * t) + self.b * xp.cos(self.w * t)


def weight(model: mujoco.MjModel, axis: int, q: Array) -> Array:
    """Generalised force `[..., nv]` of a unit of gravity along an axis of the world, at positions `[..., nq]`."""
    flat = q.reshape(-1, q.shape[-1])
    out, eye = np.zeros((len(flat), model.nv)), np.broadcast_to(np.eye(3), (len(flat), 3, 3))
    turns, origins, moving = [eye], [np.zeros((len(flat), 3))], [()]
    for body in range(1, model.nbody):
        parent, frame = int(model.body_parentid[body]), np.empty(9)
        origin = origins[parent] + turns[parent] @ model.body_pos[body]
        mujoco.mju_quat2Mat(frame, model.body_quat[body])
        turn, joints = turns[parent] @ frame.reshape(3, 3), moving[parent]
        for j in range(int(model.body_jntadr[body]), int(model.body_jntadr[body] + model.body_jntnum[body])):
            amount, arm, along = flat[:, j] - model.qpos0[j], model.jnt_pos[j], turn @ model.jnt_axis[j]
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
                origin, anchor = origin + amount[:, None] * along, None
            else:
                anchor = origin + turn @ arm
                turn = turn @ _rotations(model.jnt_axis[j], amount)
                origin = anchor - turn @ arm
            joints = (*joints, (j, along, anchor))
        turns, origins, moving = [*turns, turn], [*origins, origin], [*moving, joints]
        centre = origin + turn @ model.body_ipos[body]
        for j, along, anchor in joints:
            out[:, j] += (
                model.body_mass[body] * (along if anchor is None else np.cross(along, centre - anchor))[:, axis]
            )
    return out.reshape(*q.shape[:-1], model.nv)


def _rotations(axis: Array, angle: Array) -> Array:
    """About a unit axis, `[N, 3, 3]` (Rodrigues)."""
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = angle[:, None, None]
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * (across @ across)
