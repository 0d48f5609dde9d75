"""A bearing that stiffens while it is recorded."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class FrictionDrift(JointEffect):
    """Viscous friction that grows linearly in time, from none."""

    id: ClassVar[str] = "parameter_drift"
    family: ClassVar[str] = "time-varying"
    equation: ClassVar[str] = "tau = -r*t*qd"

    r: float = parameter("N m/rad", 0.002, low=0.0)

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """Of the friction so far."""
        return -self.r * functions(v).maximum(0.0, t) * v
