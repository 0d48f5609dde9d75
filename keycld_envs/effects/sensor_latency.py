"""A sensor that shows what was."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, SensorEffect, parameter


@dataclass(frozen=True)
class SensorLatency(SensorEffect):
    """Positions are of a moment earlier than their time says."""

    id: ClassVar[str] = "sensor_latency"
    equation: ClassVar[str] = "y(t) = q(t - d)"

    d: float = parameter("s", 0.01)

    def observe(self, t: Array) -> Array:
        """Earlier."""
        return t - self.d
