"""A push from outside."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class ExternalPulse(JointEffect):
    """A torque that somebody or something adds for a while."""

    id: ClassVar[str] = "external_pulse"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = f for start <= t < start + duration"
    phrase: ClassVar[str] = "an external pulse"
    searched: ClassVar[bool] = False

    f: float = parameter("N m", 0.05)
    start: float = parameter("s", 0.02, grid=(0.0,))
    duration: float = parameter("s", 0.02, low=0.02, grid=(0.2,))

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """On and off."""
        on = (t >= self.start) & (t < self.start + self.duration)
        return self.f * on.astype(np.float64)
