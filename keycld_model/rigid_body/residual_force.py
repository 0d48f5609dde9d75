"""The residual force: a smooth function of the joints' state, which stands for what no effect explains."""

from dataclasses import dataclass, field
from typing import ClassVar, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.effects.base import EVERY
from keycld_envs.effects.functions import functions
from keycld_model.rigid_body.scalars import Traced

Array = NDArray[np.float64]
AnyArray = Array | Traced
"""Of NumPy, or of a program while it is traced."""
Numbers = TypeVar("Numbers", Array, Traced)
OWN, DRIVEN, COMMON = 120, 24, 40
"""Random features (Rahimi and Recht, 2007) of each joint's own state, of positions for each command, which they are
multiplied by, and of all states and commands."""
BEYOND = 0.1
"""Share of the range of an input that it may be beyond; forces are taken as constant from there on."""


@dataclass(frozen=True, eq=False)
class Features:
    """Smooth functions of positions, velocities and commands.

    Attributes:
        hinge: `[nv]` joints that turn.
        middle: `[d]` mean of the inputs.
        spread: `[d]` their standard deviation.
        least: `[d]` below which an input counts as this.
        most: `[d]` above which.
        frequency: `[d, k]` of the random features: own ones, those for each command, common ones.
        phase: `[k]`.
    """

    hinge: NDArray[np.bool_]
    middle: AnyArray
    spread: AnyArray
    least: AnyArray
    most: AnyArray
    frequency: AnyArray
    phase: AnyArray

    @property
    def numbers(self) -> tuple[AnyArray, ...]:
        """All but which joints turn."""
        return self.middle, self.spread, self.least, self.most, self.frequency, self.phase

    @classmethod
    def draw(cls, hinge: NDArray[np.bool_], q: Array, v: Array, u: Array, width: float, seed: int) -> "Features":
        """Features scaled to states `[..., nv]` and commands `[..., nu]`."""
        inputs, joints = _inputs(hinge, q, v, u)
        flat = inputs.reshape(-1, inputs.shape[-1])
        rng, other = np.random.default_rng(seed), np.random.default_rng((seed, 1))
        own, driven = len(hinge) * OWN, u.shape[-1] * DRIVEN
        frequency = np.zeros((len(joints), own + driven + COMMON))
        for j in range(len(hinge)):
            mine, block = joints == j, slice(j * OWN, (j + 1) * OWN)
            frequency[mine, block] = width * rng.normal(size=(int(mine.sum()), OWN))
        positions = len(joints) - len(hinge) - u.shape[-1]
        frequency[:, -COMMON:] = width * rng.normal(size=(len(joints), COMMON))
        frequency[:positions, own : own + driven] = width * other.normal(size=(positions, driven))
        phase = rng.uniform(0, 2 * np.pi, own + COMMON)
        phase = np.insert(phase, own, other.uniform(0, 2 * np.pi, driven))
        low, high = flat.min(axis=0), flat.max(axis=0)
        beyond = BEYOND * (high - low)
        return cls(hinge, flat.mean(axis=0), flat.std(axis=0) + 1e-9, low - beyond, high + beyond, frequency, phase)

    def __call__(self, q: Numbers, v: Numbers, u: Numbers) -> Numbers:
        """`[..., 1 + d + k]`: one, the inputs, and random cosines."""
        xp, number, motors = functions(q), self.frequency.shape[1], u.shape[-1]
        inputs = _inputs(self.hinge, q, v, u)[0]
        z = (xp.clip(inputs, self.least, self.most) - self.middle) / self.spread
        own = number - COMMON - motors * DRIVEN
        size = np.repeat(np.sqrt(2 / np.array([OWN, DRIVEN, COMMON])), [own, motors * DRIVEN, COMMON])
        waves = xp.cos(z @ self.frequency + self.phase) * size
        if motors:
            commands = u / self.spread[len(self.middle) - motors :]
            driven = waves[..., own : own + motors * DRIVEN] * xp.repeat(commands, DRIVEN, axis=-1)
            waves = xp.concatenate([waves[..., :own], driven, waves[..., own + motors * DRIVEN :]], axis=-1)
        return xp.concatenate([xp.ones((*z.shape[:-1], 1)), z, waves], axis=-1)

    def precision(self, ridge: float, coupling: float, driving: float) -> Array:
        """Prior precisions of the features, `[1 + d + k]`."""
        inputs, number = self.frequency.shape
        own, out = len(self.hinge) * OWN, np.full(1 + inputs + number, ridge)
        out[1 + inputs + own : -COMMON] *= driving
        out[-COMMON:] *= coupling
        return out


def _inputs(hinge: NDArray[np.bool_], q: Numbers, v: Numbers, u: Numbers) -> tuple[Numbers, NDArray[np.int64]]:
    """Inputs `[..., d]` of the features that stand for a state and commands, and the joint of each, -1 for commands."""
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
    phrase: ClassVar[str] = "unknown physics"
    searched: ClassVar[bool] = False
    program: ClassVar[str | None] = EVERY

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
