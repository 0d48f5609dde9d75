"""A constant force at a joint."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, parameter


@dataclass(frozen=True)
class ConstantForce(JointEffect):
    """A bias of the motor, or a weight on a string."""

    id: ClassVar[str] = "constant_force"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = f"

    f: float = parameter("N m", 0.02)

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The same always."""
        return self.at_joint(model, v, np.full(v.shape[:-1], self.f))
