"""A motor that cannot give more than so much."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from keycld_envs.effects.base import ActuatorEffect, Array, parameter


@dataclass(frozen=True)
class ActuatorSaturation(ActuatorEffect):
    """Commands beyond the limit are cut."""

    id: ClassVar[str] = "actuator_saturation"
    equation: ClassVar[str] = "tau = clip(u, -s, s)"

    s: float = parameter("command", 0.05, low=0.0, grid=(0.5, 1.0, 2.0, 4.0, 8.0))

    def motor(self, u: Array, h: float) -> Array:
        """Clip."""
        return np.clip(u, -self.s, self.s)
