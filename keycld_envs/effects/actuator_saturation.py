"""A motor that cannot give more than so much."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import ActuatorEffect, Array, parameter


@dataclass(frozen=True)
class ActuatorSaturation(ActuatorEffect):
    """Commands beyond the limit are cut."""

    id: ClassVar[str] = "actuator_saturation"
    equation: ClassVar[str] = "tau = clip(u, -s, s)"

    s: float = parameter("command", 0.05, low=0.0, grid=(0.5, 1.0, 2.0, 4.0, 8.0))

    def command(self, model: mujoco.MjModel, u: Array, h: float) -> Array:
        """Clip."""
        out = u.copy()
        i = self.index(model)
        out[:, i] = np.clip(u[:, i], -self.s, self.s)
        return out
