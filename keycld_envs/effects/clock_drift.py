"""A clock that runs fast or slow."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.places import SensorEffect


@dataclass(frozen=True)
class ClockDrift(SensorEffect):
    """The sensor's clock and the motors' run at different rates."""

    id: ClassVar[str] = "clock_drift"
    equation: ClassVar[str] = "y(t) = q((1 + epsilon)*t)"

    epsilon: float = parameter("1", 0.002)

    def observe(self, t: Array) -> Array:
        """Stretched."""
        return (1 + self.epsilon) * t
