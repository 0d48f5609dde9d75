"""A spring at a joint."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import Array, Effect, parameter
from keycld_envs.effects.native import NativeModel
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class Spring(JointEffect):
    """A spring, or a cable that bends."""

    id: ClassVar[str] = "spring"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = -k*q + f"
    phrase: ClassVar[str] = "a spring"
    limiting_case: ClassVar[str] = "constant_force"

    k: float = parameter("N m/rad", 0.1, low=0.0)
    f: float = parameter("N m", 0.02)

    @property
    def q0(self) -> float:
        """Where it rests, rad."""
        return self.f / self.k if self.k else 0.0

    def native(self, model: mujoco.MjModel, later: Sequence[Effect] = ()) -> bool:
        """MuJoCo's joints have springs."""
        return True

    def write(self, target: NativeModel) -> None:
        """Add to the joint's stiffness; the two rest where their torques cancel."""
        model, joint = target.model, target.model.joint(self.where)
        i, q = joint.id, int(joint.qposadr[0])
        own = float(model.jnt_stiffness[i])
        stiffness = own + self.k
        model.qpos_spring[q] = (own * model.qpos_spring[q] + self.f) / stiffness if stiffness else 0.0
        model.jnt_stiffness[i] = stiffness

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """Hooke's law."""
        return self.f - self.k * q
