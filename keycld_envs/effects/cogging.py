"""Torque ripple over a turn."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, parameter


@dataclass(frozen=True)
class Cogging(JointEffect):
    """Magnets of a motor that prefer some angles; n cycles a turn."""

    id: ClassVar[str] = "cogging"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = a*sin(n*q) + b*cos(n*q)"

    a: float = parameter("N m", 0.02)
    b: float = parameter("N m", 0.02)
    n: float = parameter("1", 0.05, low=2.0, high=40.0, grid=(2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0))

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """A ripple."""
        angle = self.n * q[..., self.dof(model)]
        return self.at_joint(model, v, self.a * np.sin(angle) + self.b * np.cos(angle))
