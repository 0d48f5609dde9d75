"""A force without a name: a smooth function of the joints' state."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.effects.base import functions

Array = NDArray[np.float64]
OWN, COMMON = 120, 40
"""Random features (Rahimi and Recht, 2007) of each joint's own state, and of all states and commands."""


@dataclass(frozen=True, eq=False)
class Features:
    """Smooth functions of positions, velocities and commands.

    Attributes:
        hinge: `[nv]` joints that turn.
        middle: `[d]` mean of the inputs.
        spread: `[d]` their standard deviation.
        frequency: `[d, k]` of the random features.
        phase: `[k]`.
    """

    hinge: NDArray[np.bool_]
    middle: Array
    spread: Array
    frequency: Array
    phase: Array

    @classmethod
    def draw(cls, hinge: NDArray[np.bool_], q: Array, v: Array, u: Array, width: float, seed: int) -> "Features":
        """Features scaled to states `[..., nv]` and commands `[..., nu]`."""
        inputs, joints = _inputs(hinge, q, v, u)
        flat = inputs.reshape(-1, inputs.shape[-1])
        rng = np.random.default_rng(seed)
        frequency = np.zeros((len(joints), len(hinge) * OWN + COMMON))
        for j in range(len(hinge)):
            own, block = joints == j, slice(j * OWN, (j + 1) * OWN)
            frequency[own, block] = width * rng.normal(size=(int(own.sum()), OWN))
        frequency[:, -COMMON:] = width * rng.normal(size=(len(joints), COMMON))
        phase = rng.uniform(0, 2 * np.pi, frequency.shape[1])
        return cls(hinge, flat.mean(axis=0), flat.std(axis=0) + 1e-9, frequency, phase)

    def __call__(self, q: Any, v: Any, u: Any) -> Any:
        """`[..., 1 + d + k]`: one, the inputs, and random cosines."""
        xp, number = functions(q), self.frequency.shape[1]
        z = xp.clip((_inputs(self.hinge, q, v, u)[0] - self.middle) / self.spread, -4, 4)
        size = np.where(np.arange(number) < number - COMMON, np.sqrt(2 / OWN), np.sqrt(2 / COMMON))
        waves = xp.cos(z @ self.frequency + self.phase) * size
        return xp.concatenate([xp.ones((*z.shape[:-1], 1)), z, waves], axis=-1)

    def precision(self, ridge: float, coupling: float) -> Array:
        """Prior precisions of the features, `[1 + d + k]`."""
        out = np.full(1 + self.frequency.shape[0] + self.frequency.shape[1], ridge)
        out[-COMMON:] *= coupling
        return out


def _inputs(hinge: NDArray[np.bool_], q: Any, v: Any, u: Any) -> tuple[Any, NDArray[np.int64]]:
    """Numbers `[..., d]` that stand for a state and commands, and the joint of each, -1 for commands."""
    xp, angle, joint = functions(q), q[..., hinge], np.arange(len(hinge))
    owners = np.concatenate([joint[hinge], joint[hinge], joint[~hinge], joint, np.full(u.shape[-1], -1)])
    return xp.concatenate([xp.sin(angle), xp.cos(angle), q[..., ~hinge], v, u], axis=-1), owners


@dataclass(frozen=True, eq=False)
class ResidualForce(Effect):
    """A missing force that no effect of the taxonomy explains, as a function of positions, velocities and commands.

    Attributes:
        features: k of the state.
        weights: `[k, nv]` N m or N.
        precision: `[k]` of the weights' prior, in units of the usual force at each joint.
    """

    id: ClassVar[str] = "unknown"
    family: ClassVar[str] = "unknown"
    kind: ClassVar[str] = "joint"  # pyright: ignore[reportIncompatibleVariableOverride]
    equation: ClassVar[str] = "tau = f(q, qd, u)"

    features: Features = field(repr=False)
    weights: Array = field(repr=False)
    precision: Array = field(repr=False)

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple["ResidualForce", ...]:
        """None: it is fitted, not searched for."""
        return ()

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """Weighted features."""
        return self.features(q, v, u) @ self.weights

    def penalty(self, scale: Array) -> float:
        """Nats that the prior of the weights costs, in units of the usual force at each joint, `[nv]`."""
        return 0.5 * float(np.sum(self.precision[:, None] * (self.weights / scale) ** 2))
