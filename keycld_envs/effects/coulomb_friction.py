"""Dry friction."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import Confusable, parameter
from keycld_envs.effects.places import JointEffect, add_friction


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Dry friction, which also holds the joint where it is."""

    id: ClassVar[str] = "coulomb_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -c*sign(qd)"
    phrase: ClassVar[str] = "Coulomb friction"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"c": 1.0})

    c: float = parameter("N m", 0.02, low=0.0)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add to the joint's friction loss."""
        add_friction(model, self.dof(model), self.c)
