"""The equation of motion of a free pendulum, integrated for many parameters at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TERMS = ("viscous_friction", "quadratic_drag", "coulomb_friction")
"""Kinds of dissipation, by the names that effects have."""
STICK = 0.01
"""rad/s below which dry friction falls off smoothly."""
COMMON = 4
"""Parameters before those of dissipation: ln ω₀², the angle of rest, and the first angle and velocity."""


@dataclass(frozen=True)
class Motion:
    """θ'' = −ω₀² sin(θ − θ₀) − b θ' − d θ'|θ'| − c sign θ', with some of b, d and c.

    Attributes:
        terms: which of `TERMS` act.
    """

    terms: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return COMMON + len(self.terms)

    @np.errstate(over="ignore", invalid="ignore")  # of motions that nobody fits in the end
    def simulate(self, parameters: Array, times: Array) -> Array:
        """Angles at given times, by Runge-Kutta steps of fourth order.

        Args:
            parameters: [P, size]: ln ω₀², θ₀, θ(t₀), θ'(t₀), then b (1/s), d (1/rad) or c (rad/s²) as in `terms`.
            times: [T], s.

        Returns:
            [P, T], rad.
        """
        stiffness, rest, angle, speed = np.exp(parameters[:, 0]), parameters[:, 1], parameters[:, 2], parameters[:, 3]
        sizes = dict(zip(self.terms, parameters[:, COMMON:].T, strict=True))
        b, d, c = (sizes.get(term, np.zeros(len(parameters))) for term in TERMS)

        def push(q: Array, v: Array) -> Array:
            return -stiffness * np.sin(q - rest) - (b + d * np.abs(v)) * v - c * np.tanh(v / STICK)

        path = np.empty((len(parameters), len(times)))
        path[:, 0] = angle
        q, v = angle, speed
        longest = 0.15 / float(np.sqrt(stiffness.max()))
        for i in range(1, len(times)):
            gap = times[i] - times[i - 1]
            steps = max(1, int(np.ceil(gap / longest)))
            h = gap / steps
            for _ in range(steps):
                a1 = push(q, v)
                v2 = v + h / 2 * a1
                a2 = push(q + h / 2 * v, v2)
                v3 = v + h / 2 * a2
                a3 = push(q + h / 2 * v2, v3)
                v4 = v + h * a3
                a4 = push(q + h * v3, v4)
                q = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
                v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            path[:, i] = q
        return path
