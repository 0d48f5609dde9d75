"""Torque ripple over a turn."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import JointEffect

COUNTS = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 14.0, 16.0, 18.0, 20.0, 23.0, 26.0)
"""Periods per turn, or per 2 pi m, that a search starts from."""


@dataclass(frozen=True)
class Cogging(JointEffect):
    """Magnets of a motor that prefer some angles; n cycles a turn."""

    id: ClassVar[str] = "cogging"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = a*sin(n*q) + b*cos(n*q)"

    a: float = parameter("N m", 0.02)
    b: float = parameter("N m", 0.02)
    n: float = parameter("1", 0.05, low=2.0, high=40.0, grid=COUNTS)

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """A ripple."""
        xp = functions(q)
        return self.a * xp.sin(self.n * q) + self.b * xp.cos(self.n * q)
