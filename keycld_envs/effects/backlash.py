"""Play between a motor and its joint."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from keycld_envs.effects.base import Array, TransmissionEffect, functions, parameter

CONTACT, DAMPING = 250.0, 0.3
"""Angular frequency (rad/s) and damping ratio of the rotor in contact."""


@dataclass(frozen=True)
class Backlash(TransmissionEffect):
    """Teeth with a gap of 2*g: the rotor runs free inside, and hits the flanks."""

    id: ClassVar[str] = "backlash"
    equation: ClassVar[str] = "tau = k*dz(theta - q, g), j*d2theta/dt2 = u - tau"

    j: float = parameter("kg m^2", 0.002, low=0.0)
    g: float = parameter("rad", 0.01, low=0.001, high=0.5, grid=(0.02, 0.08))

    @property
    def rotor(self) -> float:
        """Inertia j."""
        return self.j

    @classmethod
    def starts(cls, where: str, inertia: float) -> Iterator[Self]:
        """Gaps of 2 to 50 mrad or mm and a rotor of 6 % of the inertia: how long it takes across is known best."""
        for g in np.geomspace(0.002, 0.05, 9):
            yield cls(where, j=0.06 * inertia, g=float(g))

    def coupling(self, twist: Array, slip: Array) -> Array:
        """Zero inside the gap, a stiff spring with damping at its flanks."""
        pressed = twist - functions(twist).clip(twist, -self.g, self.g)
        stiffness = self.j * CONTACT**2
        return functions(twist).where(pressed == 0, 0.0, stiffness * pressed + 2 * DAMPING * self.j * CONTACT * slip)
