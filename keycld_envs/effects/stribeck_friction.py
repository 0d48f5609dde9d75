"""Dry friction that is higher at low speed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import Array, JointEffect, add_friction, functions, parameter, smooth_sign


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
        add_friction(model, self.dof(model), self.c)

    def dry(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """The part that fades with speed."""
        return self.extra * functions(v).exp(-((v / self.vs) ** 2))

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """The same against the motion."""
        return -self.dry(q, v, lambda: v) * smooth_sign(v)
