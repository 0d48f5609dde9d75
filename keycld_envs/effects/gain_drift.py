"""A motor that grows weak while it is recorded."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import EVERY, Array, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import ActuatorEffect


@dataclass(frozen=True)
class GainDrift(ActuatorEffect):
    """The gain of a motor changes linearly in time: it warms up, or a battery runs low."""

    id: ClassVar[str] = "parameter_drift"
    family: ClassVar[str] = "time-varying"
    program: ClassVar[str | None] = EVERY
    at_joint: ClassVar[bool] = True
    equation: ClassVar[str] = "tau = u*(1 + r*t)"

    r: float = parameter("1/s", 0.01, low=-0.2, high=0.5)

    def change(self, t: Array, motor: Array) -> Array:
        """Change of a motor's torque, N m, at times."""
        return motor * functions(motor).maximum(-1.0, self.r * t)

    def compiled_force(
        self, memory: tuple[Array, ...], t: Array, q: Array, v: Array, motor: Callable[[], Array], h: float
    ) -> tuple[Array | None, tuple[Array, ...]]:
        """The change of the motor's torque."""
        return self.change(t, motor()), memory

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The change, at the motor's joint."""
        out = np.zeros_like(v)
        out[..., self.dof(model)] = self.change(np.broadcast_to(t, v.shape[:-1]), self.torque_of(model, u))
        return out
