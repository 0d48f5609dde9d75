"""A stop that the joint runs into."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, JointEffect, functions, parameter


@dataclass(frozen=True)
class EndStop(JointEffect):
    """A one-sided spring beyond `at`, towards the side."""

    id: ClassVar[str] = "end_stop"
    family: ClassVar[str] = "structure"
    equation: ClassVar[str] = "tau = -k*max(0, side*(q - at))*side"

    k: float = parameter("N m/rad", 0.5, low=0.0)
    at: float = parameter("rad", 0.02, grid=(-2.0, -1.0, -0.5, 0.5, 1.0, 2.0))
    side: float = 1.0

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """A spring while pressed."""
        return -self.k * functions(q).maximum(0.0, self.side * (q - self.at)) * self.side
