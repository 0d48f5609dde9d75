"""Dry friction that is higher at low speed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Confusable, Seen, parameter
from keycld_envs.effects.functions import functions, smooth_sign
from keycld_envs.effects.places import JointEffect, add_friction

FADING = (0.08, 0.3)
"""Shares of the usual speed at which dry friction has fallen, that a search starts from."""


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """Dry friction with a breakaway torque s above the sliding torque c (Armstrong-Helouvry et al., 1994)."""

    id: ClassVar[str] = "stribeck_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(c + extra*exp(-(qd/vs)^2))*sign(qd)"
    phrase: ClassVar[str] = "Stribeck friction"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"c": 1.0})

    c: float = parameter("N m", 0.02, low=0.0)
    extra: float = parameter("N m", 0.02, low=0.0)
    vs: float = parameter("rad/s", 0.1, low=0.02, high=5.0, grid=(0.3, 1.0))

    def grids(self, model: mujoco.MjModel, seen: Seen) -> dict[str, tuple[float, ...]]:
        """Fading within shares of the usual speed."""
        usual = float(seen.speed[self.dof(model)])
        return super().grids(model, seen) | {"vs": tuple(float(np.clip(s * usual, 0.02, 5.0)) for s in FADING)}

    @property
    def s(self) -> float:
        """Breakaway torque, N m."""
        return self.c + self.extra

    def edit(self, model: mujoco.MjModel) -> None:
        """Add the sliding part to the joint's friction loss."""
        add_friction(model, self.dof(model), self.c)

    def dry_friction(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """The part that fades with speed."""
        return self.extra * functions(v).exp(-((v / self.vs) ** 2))

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """The same against the motion."""
        return -self.dry_friction(q, v, lambda: v) * smooth_sign(v)
