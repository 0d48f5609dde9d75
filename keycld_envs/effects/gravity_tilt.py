"""Gravity that does not point down."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import WorldEffect, parameter


@dataclass(frozen=True)
class GravityTilt(WorldEffect):
    """A base that is not level: gravity turned about the y axis, the normal of the plane of motion."""

    id: ClassVar[str] = "gravity_tilt"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "g = |g|*(sin(alpha), 0, -cos(alpha))"

    alpha: float = parameter("rad", 0.01)

    def edit(self, model: mujoco.MjModel) -> None:
        """Turn gravity."""
        x, y, z = model.opt.gravity
        c, s = np.cos(self.alpha), np.sin(self.alpha)
        model.opt.gravity[:] = c * x - s * z, y, s * x + c * z
