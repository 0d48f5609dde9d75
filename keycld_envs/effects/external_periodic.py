"""A force from outside that comes and goes."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import FREQUENCIES, JointEffect


@dataclass(frozen=True)
class ExternalPeriodic(JointEffect):
    """A torque that swings at an angular frequency of its own."""

    id: ClassVar[str] = "external_periodic"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = a*sin(w*t) + b*cos(w*t)"

    a: float = parameter("N m", 0.02)
    b: float = parameter("N m", 0.02)
    w: float = parameter("rad/s", 0.05, low=0.5, grid=FREQUENCIES, temporal=True)

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """A sinusoid."""
        xp = functions(t)
        return self.a * xp.sin(self.w * t) + self.b * xp.cos(self.w * t)
