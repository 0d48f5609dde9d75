"""What stands between a motor and its joint."""

from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

import mujoco
import numpy as np

from keycld_envs.effects.base import Array
from keycld_envs.effects.functions import functions, if_any, repeated
from keycld_envs.effects.places import ActuatorEffect

LIGHTEST = 1e-4
"""Inertia of a rotor, kg m^2, below which it follows its joint."""


@dataclass(frozen=True)
class TransmissionEffect(ActuatorEffect):
    """An effect between a motor, whose rotor has an inertia of its own, and its joint.

    Memory: the rotor's angle and speed relative to the joint, in joint coordinates.
    """

    family: ClassVar[str] = "structure"
    at_joint: ClassVar[bool] = True
    memory: ClassVar[int] = 2
    memory_spread: ClassVar[tuple[float, ...]] = (0.1, 2.0)
    program: ClassVar[str | None] = "transmission"
    substeps: ClassVar[int] = 20

    @property
    @abstractmethod
    def rotor(self) -> float:
        """Its inertia, kg m^2."""

    @property
    def play(self) -> float:
        """How far it runs free to each side, rad."""
        return 0.0

    @classmethod
    @abstractmethod
    def starts(cls, where: str, inertia: float) -> Iterator[Self]:
        """At an actuator whose joint has an inertia: so different from each other that fits from all find the best."""

    def begin(self, model: mujoco.MjModel, v: Array) -> Array:
        """The rotor goes with its joint."""
        return np.stack(self.begin_compiled(v[..., self.dof(model)]), axis=-1)

    def begin_compiled(self, v: Array) -> tuple[Array, Array]:
        """The rotor goes with its joint."""
        return functions(v).zeros_like(v), v

    def remembered(self, memory: tuple[Array, ...], v: Array, motor: Array, h: float) -> tuple[Array, ...]:
        """The rotor's angle and speed."""
        twist, turning = memory
        return self.transmit((twist, turning), motor, v, h)[1]

    def compiled_force(
        self, memory: tuple[Array, ...], t: Array, q: Array, v: Array, motor: Callable[[], Array], h: float
    ) -> tuple[Array | None, tuple[Array, ...]]:
        """What reaches the joint less the motor's torque; its many substeps only where some rotor is not too light."""
        twist, turning = memory
        torque = motor()
        return if_any(
            self.rotor >= LIGHTEST,
            lambda: self.transmit((twist, turning), torque, v, h),
            lambda: (functions(v).zeros_like(v), (twist, turning)),
            v,
        )

    @abstractmethod
    def coupling(self, twist: Array, slip: Array) -> Array:
        """Torque on the joint, N m, for the rotor's relative angle and speed."""

    def advance(
        self, model: mujoco.MjModel, memory: Array, t: Array, q: Array, v: Array, u: Array, h: float
    ) -> tuple[Array, Array]:
        """What reaches the joint in place of the motor's torque; the joint's speed is constant over the step."""
        dof, out, motor = self.dof(model), np.zeros_like(v), self.torque_of(model, u)
        out[..., dof], (twist, speed) = self.transmit((memory[..., 0], memory[..., 1]), motor, v[..., dof], h)
        return out, np.stack([twist, speed], axis=-1)

    def transmit(
        self, memory: tuple[Array, Array], motor: Array, speed: Array, h: float
    ) -> tuple[Array, tuple[Array, Array]]:
        """What reaches the joint less the motor's torque, and the memory; all `[...]`."""
        xp, dt = functions(speed), h / self.substeps
        heavy = xp.asarray(self.rotor >= LIGHTEST)
        gain = dt / xp.where(heavy, self.rotor, 1.0)

        def substep(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            twist, turning, total = state
            torque = self.coupling(twist, turning - speed)
            turning = turning + gain * (motor - torque)
            return twist + dt * (turning - speed), turning, total + torque

        start = memory[0], memory[1], xp.zeros_like(motor)
        twist, turning, total = repeated(self.substeps, substep, start, speed)
        force = xp.where(heavy, total / self.substeps - motor, 0.0)
        return force, (xp.where(heavy, twist, memory[0]), xp.where(heavy, turning, memory[1]))
