"""A motor that cannot give more than so much."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import ActuatorEffect, Array, Seen, parameter

LIMITS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85)
"""Shares of the greatest command that a search starts from."""


@dataclass(frozen=True)
class ActuatorSaturation(ActuatorEffect):
    """Commands beyond the limit are cut."""

    id: ClassVar[str] = "actuator_saturation"
    equation: ClassVar[str] = "tau = clip(u, -s, s)"

    s: float = parameter("command", 0.05, low=0.0, grid=(0.5,))

    def grids(self, model: mujoco.MjModel, seen: Seen) -> dict[str, tuple[float, ...]]:
        """Shares of the greatest command."""
        most = float(seen.command[model.actuator(self.where).id])
        return {"s": tuple(share * most for share in LIMITS)}

    def motor(self, u: Array, h: float) -> Array:
        """Clip."""
        return np.clip(u, -self.s, self.s)
