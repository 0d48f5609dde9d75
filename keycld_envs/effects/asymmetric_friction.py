"""Dry friction that differs between directions."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import Array, Confusable, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import JointEffect, add_friction


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """Dry friction, forward and backward."""

    id: ClassVar[str] = "asymmetric_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(forward if qd > 0 else backward)*sign(qd)"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"forward": 1.0, "backward": 1.0})

    forward: float = parameter("N m", 0.02, low=0.0)
    backward: float = parameter("N m", 0.02, low=0.0)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add the mean to the joint's friction loss."""
        add_friction(model, self.dof(model), (self.forward + self.backward) / 2)

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """Half the difference, which with dry friction of the mean is exactly the two, at rest as well."""
        return functions(v).full_like(v, (self.backward - self.forward) / 2)
