"""Inertia that turns with a joint."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import parameter
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class AddedInertia(JointEffect):
    """A rotor behind a gearbox, or a flywheel."""

    id: ClassVar[str] = "added_inertia"
    family: ClassVar[str] = "inertia"
    equation: ClassVar[str] = "tau = -i*qdd"

    i: float = parameter("kg m^2", 0.005, low=0.0)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add to the joint's armature."""
        model.dof_armature[self.dof(model)] += self.i
