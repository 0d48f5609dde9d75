"""Drag that grows with the square of speed."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import parameter
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class QuadraticDrag(JointEffect):
    """Drag of a fluid."""

    id: ClassVar[str] = "quadratic_drag"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -d*qd*abs(qd)"

    d: float = parameter("N m s^2/rad^2", 0.005, low=0.0)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add to the joint's damping polynomial."""
        model.dof_dampingpoly[self.dof(model), 0] += self.d
