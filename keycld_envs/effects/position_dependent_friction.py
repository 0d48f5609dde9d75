"""Dry friction that varies over a turn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import Array, Confusable, parameter
from keycld_envs.effects.functions import functions, smooth_sign
from keycld_envs.effects.places import JointEffect, add_friction


@dataclass(frozen=True)
class PositionDependentFriction(JointEffect):
    """A bent shaft: friction c at its mean, more on one side."""

    id: ClassVar[str] = "position_dependent_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(c + a*sin(q) + b*cos(q))*sign(qd)"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"c": 1.0})

    c: float = parameter("N m", 0.02, low=0.0)
    a: float = parameter("N m", 0.02)
    b: float = parameter("N m", 0.02)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add the mean to the joint's friction loss."""
        add_friction(model, self.dof(model), self.c)

    def dry_friction(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """The part that varies."""
        xp = functions(q)
        return self.a * xp.sin(q) + self.b * xp.cos(q)

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """The same against the motion."""
        return -self.dry_friction(q, v, lambda: v) * smooth_sign(v)
