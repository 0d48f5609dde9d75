"""What an effect is: physics that a simulator leaves out, written down once, for simulation and for diagnosis."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

Kind = Literal["joint", "actuator", "body", "world", "sensor", "camera"]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """What is known of a number before it is fitted.

    Attributes:
        name: field of the effect.
        unit: its unit.
        scale: a small but noticeable value; steps of derivatives are a fraction of it.
        low: least value that physics allows.
        high: greatest value.
        grid: values to start a search from where the motion is not nearly linear in it; empty for a coefficient, in
            which the effect is linear and of which `absent` is none of it.
        absent: value at which the effect vanishes.
    """

    name: str
    unit: str
    scale: float
    low: float = -np.inf
    high: float = np.inf
    grid: tuple[float, ...] = ()
    absent: float = 0.0


def parameter(
    unit: str,
    scale: float,
    low: float = -np.inf,
    high: float = np.inf,
    grid: tuple[float, ...] = (),
    absent: float = 0.0,
) -> Any:
    """A dataclass field that holds a parameter, `absent` or first of its grid by default; see `Parameter`."""
    description = {"unit": unit, "scale": scale, "low": low, "high": high, "grid": grid, "absent": absent}
    return field(default=grid[0] if grid else absent, metadata={"parameter": description})


@dataclass(frozen=True)
class Seen:
    """What recordings show, for searches to start from.

    Attributes:
        low: `[nv]` least position of each joint, rad or m.
        high: `[nv]` greatest.
        speed: `[nv]` usual speed, rad/s or m/s.
        command: `[nu]` greatest command of each motor, without its sign.
    """

    low: Array
    high: Array
    speed: Array
    command: Array


@dataclass(frozen=True)
class Effect(ABC):
    """Physics at one place. It changes one slot of the equations; the others stay as they are.

    Subclasses override at least one of `edit`, `command`, `force`, and `observe`, or, with a memory, `begin` and
    `advance`. All are functions of arrays of any leading shape, without memory beyond their arguments, so that an
    environment, a batch of rollouts and a diagnosis use the same code; what is a function of `functions(array)` can be
    compiled, too.

    Attributes:
        where: name of the joint, actuator or body.
        memory: how many numbers the effect remembers from step to step.
        unsettled: standard deviations expected of them at the start of a recording, around where `begin` puts them.
    """

    id: ClassVar[str]
    family: ClassVar[str]
    kind: ClassVar[Kind]
    equation: ClassVar[str]
    memory: ClassVar[int] = 0
    unsettled: ClassVar[tuple[float, ...]] = ()

    where: str

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The numbers of the effect, in the order of its fields."""
        return tuple(Parameter(f.name, **f.metadata["parameter"]) for f in fields(cls) if "parameter" in f.metadata)

    @classmethod
    @abstractmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """One for each place of the model where the effect can be, absent as yet."""

    def grids(self, model: mujoco.MjModel, seen: Seen) -> dict[str, tuple[float, ...]]:
        """Values of numbers to start a search from, by name: those of the parameters, or such as recordings suggest."""
        return {p.name: p.grid for p in self.parameters() if p.grid}

    def __str__(self) -> str:
        numbers = ", ".join(f"{p.name}={getattr(self, p.name):.4g} {p.unit}".rstrip() for p in self.parameters())
        return f"{self.id} at {self.where}: {self.equation} ({numbers})"

    @property
    def key(self) -> tuple[str, str]:
        """Which effect, and where."""
        return type(self).__name__, self.where

    @property
    def forces(self) -> bool:
        """The effect adds a force."""
        return self.memory > 0 or type(self).force is not Effect.force

    @property
    def observes(self) -> bool:
        """The effect is in the measurement, not in the motion."""
        return type(self).observe is not Effect.observe

    def edit(self, model: mujoco.MjModel) -> None:  # noqa: B027 -- most effects edit nothing
        """Change a compiled model in place."""

    def command(self, model: mujoco.MjModel, u: Array, h: float) -> Array:
        """What motors get for commands `[T, nu]` at steps of h seconds, the first of which held before."""
        return u

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """Generalised force `[..., nv]` at times `[...]`, for `[..., nq]`, `[..., nv]`, and commands `[..., nu]`."""
        return np.zeros_like(v)

    def begin(self, model: mujoco.MjModel, v: Array) -> Array:
        """Memory `[..., memory]` at the start of a motion with velocities `[..., nv]`."""
        return np.zeros((*v.shape[:-1], self.memory))

    def advance(
        self, model: mujoco.MjModel, memory: Array, t: Array, q: Array, v: Array, u: Array, h: float
    ) -> tuple[Array, Array]:
        """Mean force over a step of h seconds, see `force`, and the memory after it."""
        return self.force(model, t, q, v, u), memory

    def observe(self, t: Array) -> Array:
        """Times of the motion that a sensor shows at its times `[...]`."""
        return t


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect at a joint with one degree of freedom."""

    kind: ClassVar[Kind] = "joint"

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
        return self.memory > 0 or torque or force

    @property
    def rubs(self) -> bool:
        """The effect is dry friction beyond the joint's friction loss; its torque is the same made smooth."""
        return type(self).dry is not JointEffect.dry

    def dry(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """Dry friction beyond the joint's friction loss, N m or N, and in its bearing's force N; all `[...]`."""
        return np.zeros_like(v)

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
class TransmissionEffect(ActuatorEffect):
    """An effect between a motor, whose rotor has an inertia of its own, and its joint.

    Memory: the rotor's angle and speed relative to the joint, in joint coordinates.
    """

    family: ClassVar[str] = "structure"
    at_joint: ClassVar[bool] = True
    memory: ClassVar[int] = 2
    unsettled: ClassVar[tuple[float, ...]] = (0.1, 2.0)
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
        speed = v[..., self.dof(model)]
        return np.stack([np.zeros_like(speed), speed], axis=-1)

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

    def transmit(self, memory: tuple[Array, Array], motor: Array, speed: Array, h: float) -> tuple[Array, Any]:
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


FREQUENCIES = tuple(2.0 + 0.75 * k for k in range(32))
"""Angular frequencies, rad/s, close enough for phases over recordings of some seconds to tell one from the next."""
LIGHTEST = 1e-4
"""Inertia of a rotor, kg m^2, below which it follows its joint."""


_FUNCTIONS: ContextVar[Any] = ContextVar("functions", default=None)


@contextmanager
def using(module: Any) -> Iterator[None]:
    """Compute with the functions of another module than that of the arrays, while a compiler traces effects."""
    token = _FUNCTIONS.set(module)
    try:
        yield
    finally:
        _FUNCTIONS.reset(token)


def functions(x: Any) -> Any:
    """Module with the functions for an array, NumPy for its own; see `using`."""
    return _FUNCTIONS.get() or x.__array_namespace__()


def repeated(number: int, step: Callable[[Any], Any], state: Any, x: Any) -> Any:
    """A state after so many steps, with the loop of the module that computes with x; see `functions`."""
    loop = getattr(functions(x), "repeated", None)
    if loop is not None:
        return loop(number, step, state)
    for _ in range(number):
        state = step(state)
    return state


def smooth_sign(speed: Array) -> Array:
    """Sign of a speed (rad/s or m/s), continuous through zero."""
    return functions(speed).tanh(speed / 0.02)


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
