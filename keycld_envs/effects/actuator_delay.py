"""A motor that acts late."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from keycld_envs.effects.base import ActuatorEffect, Array, parameter


@dataclass(frozen=True)
class ActuatorDelay(ActuatorEffect):
    """The command arrives after a dead time."""

    id: ClassVar[str] = "actuator_delay"
    equation: ClassVar[str] = "tau = u(t - d)"

    d: float = parameter("s", 0.01, low=0.0)

    def motor(self, u: Array, h: float) -> Array:
        """Shift, by fractions of a step as well."""
        whole, part = divmod(self.d / h, 1.0)
        late = np.concatenate([np.full(int(whole) + 1, u[0]), u])
        return (1 - part) * late[1 : len(u) + 1] + part * late[: len(u)]
