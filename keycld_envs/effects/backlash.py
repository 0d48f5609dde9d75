"""Play between a motor and its joint."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.transmission import TransmissionEffect

SOFT, HARD = 40.0, 400.0
"""Angular frequency of the rotor against a flank, rad/s, at least and at most."""


@dataclass(frozen=True)
class Backlash(TransmissionEffect):
    """Teeth with a gap of 2*g: the rotor runs free inside, and bounces off flanks that give way a little."""

    id: ClassVar[str] = "backlash"
    equation: ClassVar[str] = "tau = j*w^2*dz(theta - q, g), j*d2theta/dt2 = u - tau"

    j: float = parameter("kg m^2", 0.002, low=0.0)
    g: float = parameter("rad", 0.01, low=0.001, high=0.5, grid=(0.02, 0.08))
    w: float = parameter("rad/s", 10.0, low=SOFT, high=HARD, grid=(150.0,), temporal=True)
    zeta: float = parameter("1", 0.1, low=0.02, high=1.0, grid=(0.25,))

    @property
    def rotor(self) -> float:
        """Inertia j."""
        return self.j

    @property
    def play(self) -> float:
        """Half the gap."""
        return self.g

    @classmethod
    def starts(cls, where: str, inertia: float) -> Iterator[Self]:
        """Gaps of 6 to 180 mrad or mm, and rotors of 6 and 13 % of the inertia."""
        for share, g in itertools.product((0.06, 0.13), np.geomspace(0.003, 0.09, 5)):
            yield cls(where, j=share * inertia, g=float(g), w=120.0)

    def coupling(self, twist: Array, slip: Array) -> Array:
        """Zero inside the gap, a stiff spring with damping at its flanks."""
        pressed = twist - functions(twist).clip(twist, -self.g, self.g)
        torque = self.j * (self.w**2 * pressed + 2 * self.zeta * self.w * slip)
        return functions(twist).where(pressed == 0, 0.0, torque)
