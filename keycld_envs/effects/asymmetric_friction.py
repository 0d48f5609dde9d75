"""Dry friction that differs between directions."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, enable_friction, parameter, smooth_sign


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """Dry friction, forward and backward."""

    id: ClassVar[str] = "asymmetric_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(forward if qd > 0 else backward)*sign(qd)"

    forward: float = parameter("N m", 0.02, low=0.0)
    backward: float = parameter("N m", 0.02, low=0.0)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add the mean to the joint's friction loss."""
        enable_friction(model)
        model.dof_frictionloss[self.dof(model)] += (self.forward + self.backward) / 2

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """Half the difference, while the joint moves."""
        moving = np.abs(smooth_sign(v[..., self.dof(model)]))
        return self.at_joint(model, v, -(self.forward - self.backward) / 2 * moving)
