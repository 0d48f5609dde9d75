"""What is trained and measured, and what was published."""

from collections.abc import Sequence
from dataclasses import dataclass

from keycld_envs.errors import InputError
from keycld_model.delan.presets import PRESETS

TITLES = {
    "structured": "structured Lagrangian (DeLaN)",
    "black_box": "black-box Lagrangian",
    "hamiltonian": "structured Hamiltonian",
    "feed_forward": "feed-forward networks",
    "least_squares": "least squares of base parameters",
}
"""Models of the report."""
TEST = ("e", "q", "v")
"""Characters that no model learns from, as in the papers."""
ALL, AMOUNTS = 17, (2, 4, 8)
"""Characters to learn from and to validate with; a tenth or so validates."""
PUBLISHED: dict[str, dict[str, float]] = {
    "structured": {
        "torque": 2.18e-5, "inertial": 3.22e-5, "coriolis": 1.35e-5, "gravity": 1.96e-5, "power": 4.0e-6,
        "valid_time": 2.32,
    },
    "black_box": {
        "torque": 2.81e-5, "inertial": 1.85e-5, "coriolis": 1.98e-5, "gravity": 1.24e-5, "power": 8.9e-6,
        "valid_time": 2.76,
    },
    "hamiltonian": {
        "torque": 5.4e-6, "inertial": 2.8e-6, "coriolis": 6.3e-6, "gravity": 2.8e-6, "power": 1.4e-6,
        "valid_time": 2.90,
    },
    "feed_forward": {
        "torque": 6.17e-4, "inertial": 7.8e-4, "coriolis": 6.4e-4, "gravity": 1.1e-4, "power": 1.6e-4,
        "valid_time": 1.81,
    },
}  # fmt: skip
"""Means over ten seeds of the reference's stored models on the same file (Lutter and Peters, 2021)."""


@dataclass(frozen=True, order=True)
class Training:
    """One model to be trained.

    Attributes:
        model: preset, or "least_squares".
        seed: of initialisation, of the characters that validate, and of those that are left out.
        characters: to learn from and to validate with.
        noise: standard deviation that is added to positions, as a share of that of each joint's positions; velocities
            and accelerations are then estimated from them.
    """

    model: str
    seed: int = 0
    characters: int = ALL
    noise: float = 0.0

    @property
    def name(self) -> str:
        """Of its files."""
        amount = "" if self.characters == ALL else f"-{self.characters}"
        noise = f"-noise-{self.noise:g}" if self.noise else ""
        return f"{self.model}-{self.seed}{amount}{noise}"


def trainings(
    models: Sequence[str] = (), seeds: int = 5, characters: Sequence[int] = (), noise: float = 0.0
) -> tuple[Training, ...]:
    """All models, the most wanted first.

    Args:
        models: names; by default all.
        seeds: per model on all characters; fewer characters are learned from with the first one.
        characters: amounts; by default all.
        noise: of positions, of all characters; none by default.

    Raises:
        InputError: if a name or amount is unknown.
    """
    if unknown := [name for name in models if name not in TITLES]:
        raise InputError(f"--model names {unknown[0]!r}; there are {', '.join(TITLES)}.")
    if not 0 <= noise < 1:
        raise InputError(f"--noise is {noise:g}; it must be a share of the positions' spread, from 0 on and below 1.")
    names = [name for name in (*PRESETS, "least_squares") if not models or name in models]
    if noise:
        return tuple(Training(m, s, ALL, noise) for s in range(seeds) for m in names)
    amounts = tuple(characters) or (ALL, *AMOUNTS)
    if bad := [amount for amount in amounts if not 2 <= amount <= ALL]:
        raise InputError(f"--characters is {bad[0]}; it must be from 2 to {ALL}.")
    whole = [Training(m, s) for s in range(seeds) for m in names if s == 0 or m != "least_squares"]
    fewer = [Training(m, 0, amount) for amount in sorted(set(amounts) - {ALL}) for m in names]
    return (*(whole if ALL in amounts else ()), *fewer)
