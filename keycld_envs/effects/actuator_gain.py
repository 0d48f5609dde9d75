"""A motor that is stronger or weaker than thought."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import ActuatorEffect, Array, parameter


@dataclass(frozen=True)
class ActuatorGain(ActuatorEffect):
    """The motor's torque is k times what the simulator believes."""

    id: ClassVar[str] = "actuator_gain"
    equation: ClassVar[str] = "tau = k*u"

    k: float = parameter("1", 0.02, low=0.0, absent=1.0)

    def motor(self, u: Array, h: float) -> Array:
        """Scale."""
        return self.k * u
