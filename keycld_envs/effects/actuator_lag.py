"""A motor that follows with a lag of first order."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.signal import lfilter

from keycld_envs.effects.base import ActuatorEffect, Array, parameter


@dataclass(frozen=True)
class ActuatorLag(ActuatorEffect):
    """The torque approaches the command with a time constant."""

    id: ClassVar[str] = "actuator_lag"
    equation: ClassVar[str] = "lag*da/dt = u - a"

    lag: float = parameter("s", 0.01, low=0.0)

    def motor(self, u: Array, h: float) -> Array:
        """Filter; exact for a command that is constant over a step, averaged over the step."""
        if self.lag <= 0:
            return u
        keep = np.exp(-h / self.lag)
        after = lfilter([1 - keep], [1, -keep], u, zi=[keep * u[0]])[0]  # at the ends of the steps
        before = np.concatenate([u[:1], after[:-1]])
        return u + (before - u) * self.lag / h * (1 - keep)
