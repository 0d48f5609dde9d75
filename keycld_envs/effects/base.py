"""What an effect is: physics that a simulator leaves out, written down once, for simulation and for diagnosis."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects.native import NativeModel

Kind = Literal["joint", "actuator", "body", "world", "sensor", "camera"]
Array = NDArray[np.float64]
EVERY = "every"
"""Group of effects that are cheap enough to have a slot in every compiled program with effects."""


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
        temporal: it is a frequency in time, whose unit is the same at a hinge and at a slide.
    """

    name: str
    unit: str
    scale: float
    low: float = -np.inf
    high: float = np.inf
    grid: tuple[float, ...] = ()
    absent: float = 0.0
    temporal: bool = False


def parameter(
    unit: str,
    scale: float,
    low: float = -np.inf,
    high: float = np.inf,
    grid: tuple[float, ...] = (),
    absent: float = 0.0,
    temporal: bool = False,
) -> Any:
    """A dataclass field that holds a parameter, `absent` or first of its grid by default; see `Parameter`."""
    description = {"unit": unit, "scale": scale, "low": low, "high": high, "grid": grid, "absent": absent}
    description["temporal"] = temporal
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
class Confusable:
    """What an effect is easily taken for.

    Attributes:
        group: effects of one group, at the same place, do nearly the same.
        unit: the effect's parameters when its size is one, in a unit that all of the group share.
        on_rails: it does so only in models in which some joint slides.
    """

    group: str
    unit: Mapping[str, float]
    on_rails: bool = False


@dataclass(frozen=True)
class Effect(ABC):
    """Physics at one place. It changes one slot of the equations; the others stay as they are.

    What steps a motion in NumPy calls `advance`; programs that are compiled call `compiled_force`, `dry_friction`,
    `base_acceleration` and `mass_factor`, whose arrays are NumPy's or a compiler's; see `functions`.

    Subclasses override at least one of `edit`, `command`, `force`, and `observe`, or, with a memory, `begin` and
    `advance`. All are functions of arrays of any leading shape, without memory beyond their arguments, so that an
    environment, a batch of rollouts and a diagnosis use the same code; what is a function of `functions(array)` can be
    compiled, too.

    Attributes:
        where: name of the joint, actuator or body.
        id: what it is called in reports.
        family: slot of the equations that it changes.
        kind: of the place where it is.
        equation: what it adds.
        phrase: its name in a sentence, with an article if it has one; empty if that is its id.
        searched: a search tries it; others are found in another way.
        memory: how many numbers the effect remembers from step to step.
        memory_spread: standard deviations expected of them at the start of a recording, around where `begin` puts them.
        program: group of effects that come together into compiled programs: `EVERY`, or the name of a group whose
            effects are costly, and are in a program only if it needs one of them; None if it is only stepped in NumPy.
        confusable: what it is easily taken for.
        limiting_case: id of the effect that it has as a limit, far from where its parameters are.
        same_everywhere: id of an effect that does nearly the same if it is at all its places at once.
    """

    id: ClassVar[str]
    family: ClassVar[str]
    kind: ClassVar[Kind]
    equation: ClassVar[str]
    phrase: ClassVar[str] = ""
    searched: ClassVar[bool] = True
    memory: ClassVar[int] = 0
    memory_spread: ClassVar[tuple[float, ...]] = ()
    program: ClassVar[str | None] = None
    confusable: ClassVar[Confusable | None] = None
    limiting_case: ClassVar[str] = ""
    same_everywhere: ClassVar[str] = ""

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

    def with_parameters(self, **values: float) -> Self:
        """The effect with other numbers, each as near as its bounds allow."""
        bounds = {p.name: (p.low, p.high) for p in self.parameters()}
        return replace(self, **{name: float(np.clip(value, *bounds[name])) for name, value in values.items()})

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

    @property
    def has_dry_friction(self) -> bool:
        """The effect is dry friction beyond the joint's friction loss; its force is the same made smooth."""
        return type(self).dry_friction is not Effect.dry_friction

    @property
    def only_edits(self) -> bool:
        """The numbers of a model that it changes are all there is to the effect."""
        commands = self.kind == "actuator" or type(self).command is not Effect.command
        return type(self).edit is not Effect.edit and not (self.forces or self.observes or commands)

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

    def slot(self, model: mujoco.MjModel) -> tuple[int, int]:
        """Indices of its joint, body (the world is none) or axis of the world, and of its actuator, -1 for none."""
        return (int(model.body(self.where).id) - 1 if self.kind == "body" else 0), -1

    def begin_compiled(self, v: Array) -> tuple[Array, ...]:
        """What `begin` puts into the memory, for velocities `[...]` of its joint."""
        return ()

    def remembered(self, memory: tuple[Array, ...], v: Array, motor: Array, h: float) -> tuple[Array, ...]:
        """Memory after a step; see `compiled_force`."""
        return memory

    def compiled_force(
        self, memory: tuple[Array, ...], t: Array, q: Array, v: Array, motor: Callable[[], Array], h: float
    ) -> tuple[Array | None, tuple[Array, ...]]:
        """Mean force on its joint over a step, and memory after it; asked of effects at joints and actuators.

        Args:
            memory: before the step, `memory` numbers, each `[...]` like all others.
            t: times in the middle of the step, s.
            q: positions of its joint there, rad or m.
            v: velocities there.
            motor: gives the torque of its actuator, N m or N.
            h: s.

        Returns:
            N m or N, None for no force; and the memory.
        """
        return None, memory

    def dry_friction(self, q: Array, v: Array, load: Callable[[], Array]) -> Array | None:
        """Dry friction beyond the friction loss of its joint, N m or N, all `[...]`.

        Args:
            q: position of its joint, rad or m.
            v: velocity.
            load: gives the force in its bearing, N; of an effect at an actuator, the torque of that, N m or N.
        """
        return None

    def base_acceleration(self, t: Array) -> Array | None:
        """Acceleration of the base along its axis of the world at times, m/s^2."""
        return None

    def mass_factor(self, t: Array) -> Array | None:
        """Factor of the mass of its body at times."""
        return None

    @property
    def size(self) -> float:
        """How large it is, in the unit of effects that it may be confused with."""
        unit = self.confusable.unit if self.confusable else {}
        return float(np.mean([getattr(self, name) / one for name, one in unit.items()])) if unit else 0.0

    def of_size(self, size: float) -> Self:
        """The effect as large as another that it may be confused with."""
        unit = self.confusable.unit if self.confusable else {}
        return self.with_parameters(**{name: one * size for name, one in unit.items()})

    def confusable_with(self, others: Iterable["Effect"], model: mujoco.MjModel) -> Iterator["Effect"]:
        """Others that do nearly the same at the same place, as large as this one; each kind at a place once.

        They differ where responses are least linear, or to second order, so that a search has to try them one by one.
        """
        mine, tried = self.confusable, {self.key}
        if mine is None or self.size <= 0:
            return
        rails = bool((model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE).any())
        for other in others:
            theirs, near = other.confusable, other.where == self.where or "sensor" in (other.kind, self.kind)
            if theirs is None or theirs.group != mine.group or not near or other.key in tried:
                continue
            if rails or not theirs.on_rails:
                tried.add(other.key)
                yield other.of_size(self.size)

    def indistinguishable(self, model: mujoco.MjModel) -> tuple[tuple[str, Kind, str], ...]:
        """What is no effect, and moves a model in the same way: name, kind of place, and place."""
        return ()

    def native(self, model: mujoco.MjModel, later: Sequence["Effect"] = ()) -> bool:
        """MuJoCo has the effect itself; of an actuator, before later effects of the same one."""
        return self.only_edits

    def write(self, target: NativeModel) -> None:
        """Write the effect, if it is native, into a model."""
        self.edit(target.model)
