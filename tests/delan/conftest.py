"""Motions of a pendulum with friction, and of the arm of the characters, by formula."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

Q = dict[str, np.ndarray]
INERTIA, WEIGHT, B, C = 0.5, 2.0, 0.3, 0.1


def arm(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Q:
    """Parts of the torque of the two-joint arm that wrote the characters."""
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    m11, m12, m22 = 1.372729 + c2, 0.517615 + 0.5 * c2, 0.517615
    fall = np.cos(q[:, 0] + q[:, 1])
    return {
        "m": np.stack([m11 * a[:, 0] + m12 * a[:, 1], m12 * a[:, 0] + m22 * a[:, 1]], axis=1),
        "c": np.stack([-0.5 * s2 * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2), 0.5 * s2 * v[:, 0] ** 2], axis=1),
        "g": np.stack([2.625 * np.cos(q[:, 0]) + 1.5 * fall, 1.5 * fall], axis=1),
    }


def waves(rng: np.random.Generator, t: np.ndarray, joints: int, size: float = 0.6) -> tuple[np.ndarray, ...]:
    """Positions, velocities and accelerations `[T, joints]`: sums of three sines."""
    f, phase, height = (rng.uniform(low, high, (3, joints)) for low, high in ((1.0, 4.0), (0, 6.3), (0.2, size)))
    x = f * t[:, None, None] + phase
    return (height * np.sin(x)).sum(1), (height * f * np.cos(x)).sum(1), (-height * f**2 * np.sin(x)).sum(1)


@pytest.fixture
def letters(tmp_path: Path) -> Path:
    """An archive like that of the characters: six motions of 60 samples of the two-joint arm."""
    t, signals = 0.04 * np.arange(60), []
    for i in range(6):
        q, v, a = waves(np.random.default_rng(i), t, 2)
        parts = arm(q, v, a)
        signals.append({"t": t, "qp": q, "qv": v, "qa": a, "tau": sum(parts.values()), **parts})
    arrays: dict[str, Any] = {name: np.concatenate([s[name] for s in signals]) for name in signals[0]}
    path = tmp_path / "letters.npz"
    np.savez(path, labels=np.array(list("abcdef")), lengths=np.full(6, 60), **arrays)
    return path


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    """An archive of five motions of a pendulum with viscous and Coulomb friction."""
    t, signals = 0.02 * np.arange(120), []
    for i in range(5):
        q, v, a = waves(np.random.default_rng(i), t, 1, 1.2)
        tau = INERTIA * a + WEIGHT * np.sin(q) + B * v + C * np.tanh(v / 0.02)
        signals.append({"t": t, "qp": q, "qv": v, "qa": a, "tau": tau})
    arrays: dict[str, Any] = {name: np.concatenate([s[name] for s in signals]) for name in signals[0]}
    path = tmp_path / "pendulum.npz"
    np.savez(path, labels=np.array(list("abcde")), lengths=np.full(5, 120), **arrays)
    return path
