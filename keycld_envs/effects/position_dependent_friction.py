"""Dry friction that varies over a turn."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, enable_friction, parameter, smooth_sign


@dataclass(frozen=True)
class PositionDependentFriction(JointEffect):
    """A bent shaft: friction c at its mean, more on one side."""

    id: ClassVar[str] = "position_dependent_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(c + a*sin(q) + b*cos(q))*sign(qd)"

    c: float = parameter("N m", 0.02, low=0.0)
    a: float = parameter("N m", 0.02)
    b: float = parameter("N m", 0.02)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add the mean to the joint's friction loss."""
        enable_friction(model)
        model.dof_frictionloss[self.dof(model)] += self.c

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The part that varies."""
        dof = self.dof(model)
        varying = self.a * np.sin(q[..., dof]) + self.b * np.cos(q[..., dof])
        return self.at_joint(model, v, -varying * smooth_sign(v[..., dof]))
