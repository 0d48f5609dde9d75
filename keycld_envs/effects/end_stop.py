"""A stop that the joint runs into."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import mujoco

from keycld_envs.effects.base import Array, Seen, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import JointEffect

DEPTHS = (0.03, 0.08, 0.15, 0.25, 0.4, 0.6)
"""Shares of a joint's range that a search has beyond a stop."""


@dataclass(frozen=True)
class EndStop(JointEffect):
    """A one-sided spring and damper beyond `at`, towards the side; it pushes back, and never pulls."""

    id: ClassVar[str] = "end_stop"
    family: ClassVar[str] = "structure"
    equation: ClassVar[str] = "tau = -side*max(0, k*x + d*side*qd), x = side*(q - at)"
    phrase: ClassVar[str] = "an end stop"

    k: float = parameter("N m/rad", 0.5, low=0.0)
    d: float = parameter("N m s/rad", 0.02, low=0.0)
    at: float = parameter("rad", 0.02, grid=(0.0,))
    side: float = 1.0

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """At either end of every joint."""
        return tuple(replace(stop, side=side) for stop in super().candidates(model) for side in (1.0, -1.0))

    def grids(self, model: mujoco.MjModel, seen: Seen) -> dict[str, tuple[float, ...]]:
        """Near the end of where the joint was seen."""
        low, high = (float(x[self.dof(model)]) for x in (seen.low, seen.high))
        end, back = (high, low) if self.side > 0 else (low, high)
        return {"at": tuple(end + depth * (back - end) for depth in DEPTHS)}

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """Pushes back while pressed."""
        xp, depth = functions(q), self.side * (q - self.at)
        push = xp.maximum(0.0, self.k * depth + self.d * self.side * v)
        return xp.where(depth > 0, -self.side * push, 0.0)
