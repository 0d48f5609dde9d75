"""A spring at a joint."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, JointEffect, parameter


@dataclass(frozen=True)
class Spring(JointEffect):
    """A spring, or a cable that bends."""

    id: ClassVar[str] = "spring"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = -k*q + f"

    k: float = parameter("N m/rad", 0.1, low=0.0)
    f: float = parameter("N m", 0.02)

    @property
    def q0(self) -> float:
        """Where it rests, rad."""
        return self.f / self.k if self.k else 0.0

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """Hooke's law."""
        return self.f - self.k * q
