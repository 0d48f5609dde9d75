"""A shaft that twists between a motor and its joint."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.transmission import TransmissionEffect

SOFT, STIFF = 0.5, 2000.0
"""Stiffness at least and at most, N m/rad."""


@dataclass(frozen=True)
class JointFlexibility(TransmissionEffect):
    """A spring between a rotor and the link (Spong, 1987), with the damping ratio of the rotor against a fixed link."""

    id: ClassVar[str] = "joint_flexibility"
    equation: ClassVar[str] = "tau = k*(theta - q), j*d2theta/dt2 = u - tau"

    j: float = parameter("kg m^2", 0.002, low=0.0)
    k: float = parameter("N m/rad", 1.0, low=SOFT, high=STIFF, grid=(5.0, 20.0, 80.0))
    zeta: float = parameter("1", 0.05, low=0.0, high=1.0, grid=(0.05,))

    @property
    def rotor(self) -> float:
        """Inertia j."""
        return self.j

    @classmethod
    def starts(cls, where: str, inertia: float) -> Iterator[Self]:
        """Rotors of 4 and 12 % of the inertia, which swing against a fixed link with 20 to 150 rad/s."""
        for share, speed in itertools.product((0.04, 0.12), (20.0, 40.0, 75.0, 150.0)):
            j = share * inertia
            yield cls(where, j=j, k=float(np.clip(j * speed**2, SOFT, STIFF)))

    def coupling(self, twist: Array, slip: Array) -> Array:
        """Spring and damper."""
        return self.k * twist + 2 * self.zeta * (self.k * self.j) ** 0.5 * slip
