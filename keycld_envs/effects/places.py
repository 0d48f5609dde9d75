"""Effects by the kind of place where they are: joints, actuators, the surroundings, sensors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import mujoco
import numpy as np

from keycld_envs.effects.base import EVERY, Array, Effect, Kind


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect at a joint with one degree of freedom.

    One with a force on other joints, or with a memory, overrides `compiled_force`, or is in no `program`.
    """

    kind: ClassVar[Kind] = "joint"
    program: ClassVar[str | None] = EVERY

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """Every hinge and slide."""
        return tuple(cls(model.joint(j).name) for j in range(model.njnt))

    def dof(self, model: mujoco.MjModel) -> int:
        """Index among the velocities."""
        return int(model.jnt_dofadr[model.joint(self.where).id])

    @property
    def forces(self) -> bool:
        """The effect adds a torque, or a force of more joints than its own."""
        torque, force = type(self).torque is not JointEffect.torque, type(self).force is not JointEffect.force
        return self.memory > 0 or torque or force or self.has_dry_friction

    def slot(self, model: mujoco.MjModel) -> tuple[int, int]:
        """Index of its joint."""
        return self.dof(model), -1

    def compiled_force(
        self, memory: tuple[Array, ...], t: Array, q: Array, v: Array, motor: Callable[[], Array], h: float
    ) -> tuple[Array | None, tuple[Array, ...]]:
        """Its torque, unless it is dry friction."""
        return (None if self.has_dry_friction else self.torque(t, q, v)), memory

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """N m or N at times, for positions and velocities of this joint, all `[...]`."""
        return np.zeros_like(v)

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The torque, at this joint."""
        dof, out = self.dof(model), np.zeros_like(v)
        out[..., dof] = self.torque(t, q[..., dof], v[..., dof])
        return out


@dataclass(frozen=True)
class ActuatorEffect(Effect):
    """An effect at an actuator.

    Attributes:
        at_joint: it acts on the actuator's joint, and needs one.
    """

    kind: ClassVar[Kind] = "actuator"
    family: ClassVar[str] = "actuation"
    at_joint: ClassVar[bool] = False

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """Every actuator; of effects on its joint, every one that acts on a joint."""
        kinds = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
        on_joint = np.isin(model.actuator_trntype, kinds)
        return tuple(cls(model.actuator(i).name) for i in range(model.nu) if on_joint[i] or not cls.at_joint)

    def motor(self, u: Array, h: float) -> Array:
        """What the motor gets for its commands `[T]`; see `command`."""
        return u

    def dof(self, model: mujoco.MjModel) -> int:
        """Index of its joint among the velocities."""
        return int(model.jnt_dofadr[model.actuator(self.where).trnid[0]])

    def slot(self, model: mujoco.MjModel) -> tuple[int, int]:
        """Indices of its joint and actuator."""
        return self.dof(model), int(model.actuator(self.where).id)

    def native(self, model: mujoco.MjModel, later: Sequence[Effect] = ()) -> bool:
        """MuJoCo has only some."""
        return False

    def torque_of(self, model: mujoco.MjModel, u: Array) -> Array:
        """What the actuator does, in joint coordinates, for commands `[..., nu]`."""
        i = int(model.actuator(self.where).id)
        return model.actuator_gear[i, 0] * model.actuator_gainprm[i, 0] * u[..., i]

    def command(self, model: mujoco.MjModel, u: Array, h: float) -> Array:
        """The same for all motors: the others get what they are told."""
        i, out = int(model.actuator(self.where).id), u.copy()
        out[:, i] = self.motor(u[:, i], h)
        return out


@dataclass(frozen=True)
class WorldEffect(Effect):
    """An effect of the surroundings."""

    kind: ClassVar[Kind] = "world"
    where: str = "world"

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """One."""
        return (cls(),)


@dataclass(frozen=True)
class SensorEffect(Effect):
    """An effect of the measurement."""

    kind: ClassVar[Kind] = "sensor"
    family: ClassVar[str] = "observation"
    where: str = "clock"

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """One, for all joints."""
        return (cls(),)


LONGEST = 2.0
"""Seconds, of the dead time and of the lag of a motor."""
FREQUENCIES = tuple(2.0 + 0.75 * k for k in range(32))
"""Angular frequencies, rad/s, close enough for phases over recordings of some seconds to tell one from the next."""


def flat(x: Array) -> Array:
    """`[..., n]` as `[N, n]`, also of no numbers: a model may have no motors."""
    return x.reshape(math.prod(x.shape[:-1]), x.shape[-1])


def add_friction(model: mujoco.MjModel, dof: int, loss: float) -> None:
    """Add dry friction (N m or N), also to a model that switches all constraints off, as dm_control's acrobot does."""
    model.dof_frictionloss[dof] += loss
    off, flags = mujoco.mjtDisableBit, int(model.opt.disableflags)
    constraint = int(off.mjDSBL_CONSTRAINT)
    if flags & constraint:
        others = int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT) | int(off.mjDSBL_EQUALITY)
        model.opt.disableflags = (flags & ~constraint) | others
