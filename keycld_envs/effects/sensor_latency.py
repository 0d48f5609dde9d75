"""A sensor that shows what was."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, Confusable, parameter
from keycld_envs.effects.places import SensorEffect


@dataclass(frozen=True)
class SensorLatency(SensorEffect):
    """Positions are of a moment earlier than their time says."""

    id: ClassVar[str] = "sensor_latency"
    phrase: ClassVar[str] = "a sensor latency"
    equation: ClassVar[str] = "y(t) = q(t - d)"
    confusable: ClassVar[Confusable | None] = Confusable("lateness", {"d": 1.0})
    same_everywhere: ClassVar[str] = "actuator_delay"

    d: float = parameter("s", 0.01)

    def observe(self, t: Array) -> Array:
        """Earlier."""
        return t - self.d
