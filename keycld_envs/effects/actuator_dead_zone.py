"""A motor that ignores small commands."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.places import ActuatorEffect


@dataclass(frozen=True)
class ActuatorDeadZone(ActuatorEffect):
    """Commands within the zone do nothing, larger ones are smaller by its width."""

    id: ClassVar[str] = "actuator_dead_zone"
    equation: ClassVar[str] = "tau = sign(u)*max(0, abs(u) - delta)"
    phrase: ClassVar[str] = "an actuator dead zone"

    delta: float = parameter("command", 0.02, low=0.0)

    def motor(self, u: Array, h: float) -> Array:
        """Cut out the middle."""
        return np.sign(u) * np.maximum(0.0, np.abs(u) - self.delta)
