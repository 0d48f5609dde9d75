"""Friction that grows with speed."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import parameter
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """Lubricated friction, or a motor's back-EMF."""

    id: ClassVar[str] = "viscous_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -b*qd"

    b: float = parameter("N m s/rad", 0.02, low=0.0)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add to the joint's damping."""
        model.dof_damping[self.dof(model)] += self.b
