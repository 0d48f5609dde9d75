"""Dry friction that is higher at low speed."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, enable_friction, parameter, smooth_sign


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """Dry friction with a breakaway torque s above the sliding torque c (Armstrong-Helouvry et al., 1994)."""

    id: ClassVar[str] = "stribeck_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(c + (s - c)*exp(-(qd/vs)^2))*sign(qd)"

    c: float = parameter("N m", 0.02, low=0.0)
    extra: float = parameter("N m", 0.02, low=0.0)
    vs: float = parameter("rad/s", 0.1, low=0.05, high=5.0, grid=(0.3, 1.0))

    @property
    def s(self) -> float:
        """Breakaway torque, N m."""
        return self.c + self.extra

    def edit(self, model: mujoco.MjModel) -> None:
        """Add the sliding part to the joint's friction loss."""
        enable_friction(model)
        model.dof_frictionloss[self.dof(model)] += self.c

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The part that fades with speed."""
        speed = v[..., self.dof(model)]
        return self.at_joint(model, v, -self.extra * np.exp(-((speed / self.vs) ** 2)) * smooth_sign(speed))
