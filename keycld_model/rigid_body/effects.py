"""Effects that push, inside the compiled steps of a mechanism.

A program has a slot for every effect of its groups at every place, so that programs are few: what is absent has
parameters that make it nothing.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import EFFECTS, Effect
from keycld_envs.effects.base import EVERY
from keycld_envs.effects.functions import using
from keycld_model.rigid_body.residual_force import AnyArray, Features, ResidualForce
from keycld_model.rigid_body.scalars import Quick, Traced

Array = NDArray[np.float64]
TracedEffect = Any
"""An effect whose parameters are arrays over rollouts while a program is traced, in place of numbers."""
Memory = tuple[Traced, ...]
"""What an effect remembers, each number `[...]`."""
SHAPE = 256, 16, 8
"""Steps, variants and recordings are filled up to multiples of these where memories are computed, for each shape is
compiled anew."""


@dataclass(frozen=True)
class EffectSlot:
    """Where an effect can be.

    Attributes:
        absent: the effect, with parameters that make it nothing.
        at: index of its joint, body (the world is no body) or axis of the world.
        motor: index of its actuator, or -1.
    """

    absent: Effect
    at: int
    motor: int = -1

    @property
    def key(self) -> tuple[str, str]:
        """What the effect is, and where."""
        return self.absent.key

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the effect's numbers."""
        return _names(type(self.absent))

    def numbers(self, effect: Effect) -> list[float]:
        """Numbers of an effect of the slot's kind."""
        return [float(getattr(effect, name)) for name in self.names]

    def filled(self, numbers: Sequence[Traced]) -> TracedEffect:
        """The effect with these numbers, each `[N]`."""
        return replace(self.absent, **dict(zip(self.names, numbers, strict=True)))


def _names(kind: type[Effect]) -> tuple[str, ...]:
    """Fields of an effect that hold numbers."""
    return tuple(f.name for f in fields(kind) if f.name != "where")


@dataclass(frozen=True)
class AppliedEffects:
    """Effects of a variant that push.

    Attributes:
        effects: in any order.
        memories: of each at the starts of W windows, `[W, memory]`.
    """

    effects: tuple[Effect, ...] = ()
    memories: tuple[Array, ...] = ()


@dataclass(frozen=True)
class EffectSlots:
    """All slots of a program.

    Attributes:
        slots: in the order of their numbers.
        turning: which joints turn, if the program has a residual force; None otherwise.
    """

    slots: tuple[EffectSlot, ...] = ()
    turning: tuple[bool, ...] | None = None

    @classmethod
    def of(cls, model: mujoco.MjModel, effects: Iterable[Effect]) -> "EffectSlots":
        """Slots that take some effects; empty if there are none."""
        kinds = {type(effect) for effect in effects}
        if not kinds:
            return cls()
        turning = tuple(bool(t == mujoco.mjtJoint.mjJNT_HINGE) for t in model.jnt_type)
        known = dict.fromkeys(
            (*EFFECTS.values(), *sorted(kinds, key=lambda kind: kind.__name__))
        )  # and what is not ours
        groups = dict.fromkeys((EVERY, *(kind.program for kind in known if kind.program is not None)))
        wanted = {EVERY, *(kind.program for kind in kinds)}
        out = {}
        for group in groups:
            for kind in known if group in wanted else ():
                for effect in kind.candidates(model) if kind.program == group else ():
                    if effect.forces:
                        slot = EffectSlot(effect, *effect.slot(model))
                        out.setdefault(slot.key, slot)
        return cls(tuple(out.values()), turning if ResidualForce in kinds else None)

    def numbers(self, effects: Sequence[Effect]) -> Array:
        """Numbers of all slots with some effects in them, `[K]`."""
        here = {effect.key: effect for effect in effects}
        return np.array([x for slot in self.slots for x in slot.numbers(here.get(slot.key, slot.absent))])

    def remembered(self, applied: AppliedEffects, windows: int) -> Array:
        """Memories of all slots at the starts of windows, `[W, M]`."""
        pairs = zip(applied.effects, applied.memories, strict=True)
        here = {effect.key: memory for effect, memory in pairs}
        empty = np.zeros((windows, 0))
        parts = [here.get(slot.key, np.zeros((windows, slot.absent.memory))) for slot in self.slots]
        return np.concatenate([empty, *parts], axis=1)

    def traced(self, numbers: Traced, residual: Sequence[Traced]) -> "TracedEffects":
        """Effects with numbers `[K, N]`, and those of a residual force, while a program is traced."""
        ends = np.cumsum([len(slot.names) for slot in self.slots])[:-1]
        pieces = jnp.split(numbers, ends) if self.slots else []
        filled = [(slot, slot.filled(list(piece))) for slot, piece in zip(self.slots, pieces, strict=True)]
        if self.turning is None:
            return TracedEffects(filled, None)
        *features, weights = residual
        return TracedEffects(filled, (Features(np.array(self.turning), *features), weights))


def residual_numbers(effects: Iterable[Effect]) -> tuple[AnyArray, ...]:
    """Numbers of the one residual force among effects; empty if there is none.

    Raises:
        ValueError: if there are several.
    """
    forces = {id(effect): effect for effect in effects if isinstance(effect, ResidualForce)}
    if not forces:
        return ()
    if len(forces) > 1:
        raise ValueError("Rollouts that are simulated together may have one residual force between them.")
    (force,) = forces.values()
    return *force.features.numbers, force.weights


@dataclass(frozen=True)
class TracedEffects:
    """Effects while a program is traced; every number is an array over N rollouts.

    Attributes:
        effects: in their slots.
        residual: features and weights of a residual force, of all rollouts.
    """

    effects: list[tuple[EffectSlot, TracedEffect]]
    residual: tuple[Features, Traced] | None

    def surroundings(self, bodies: Traced, gravity: Sequence[Traced], t: Traced) -> tuple[Traced, tuple[Traced, ...]]:
        """Numbers of bodies `[nb, 10, N]` and gravity, at times `[N]`."""
        pull = list(gravity)
        with using(Quick()):
            for slot, effect in self.effects:
                if (acceleration := effect.base_acceleration(t)) is not None:
                    pull[slot.at] = pull[slot.at] - acceleration
                if (factor := effect.mass_factor(t)) is not None:
                    heavy = jnp.array([0, 4, 5, 6])  # mass and moments of inertia
                    bodies = bodies.at[slot.at, heavy].multiply(factor)
        return bodies, tuple(pull)

    def dry_friction(
        self,
        friction: Traced,
        q: Traced,
        v: Traced,
        bearing: Callable[[int], Traced],
        motor: Callable[[int], Traced],
    ) -> Traced:
        """Dry friction `[nv, N]` with that of effects.

        Args:
            friction: without.
            q: positions `[nv, N]`.
            v: velocities.
            bearing: force in the bearing of a joint, `[N]`.
            motor: torque of an actuator at its joint, `[N]`.
        """
        with using(Quick()):
            for slot, effect in self.effects:
                if effect.has_dry_friction:
                    load, place = (bearing, slot.at) if slot.motor < 0 else (motor, slot.motor)
                    more = effect.dry_friction(q[slot.at], v[slot.at], functools.partial(load, place))
                    friction = friction.at[slot.at].add(more)
        return jnp.maximum(friction, 0.0)

    def forces(
        self,
        memory: Traced,
        t: Traced,
        q: Traced,
        v: Traced,
        u: Traced,
        motor: Callable[[int], Traced],
        h: Traced,
    ) -> tuple[Traced, Traced]:
        """Mean forces on the joints over a step, `[nv, N]`, and what effects remember after it.

        Args:
            memory: before it, `[M, N]`.
            t: times `[N]` in its middle.
            q: positions `[nv, N]` there.
            v: velocities there.
            u: commands `[nu, N]`.
            motor: torque of an actuator, `[N]`.
            h: s.
        """
        force, left, after = [jnp.zeros_like(x) for x in v], iter(memory), []
        with using(Quick()):
            if self.residual is not None:
                features, weights = self.residual
                force = list((features(q.T, v.T, u.T) @ weights).T)
            for slot, effect in self.effects:
                at, own = slot.at, tuple(itertools.islice(left, effect.memory))
                if effect.kind not in ("joint", "actuator"):
                    continue
                push, own = effect.compiled_force(own, t, q[at], v[at], functools.partial(motor, slot.motor), h)
                after.extend(own)
                if push is not None:
                    force[at] = force[at] + push
        return jnp.stack(force), jnp.stack(after) if after else memory


def memories(effects: Sequence[Effect], motor: Array, speed: Array, starts: Array, h: float) -> Array:
    """What effects of one kind remember along recordings, `[T + 1, V, R, memory]`.

    Args:
        effects: V of them, with a memory, at one place.
        motor: torque of the actuator there, if any, at T steps of R recordings, `[T, V, R]`.
        speed: of the joint there, `[T, R]`.
        starts: what they remember at first, beyond where they begin, `[V, R, memory]`.
        h: s per step.
    """
    arrays = tuple((array.shape, array.tobytes()) for array in (motor, speed, starts))
    return _memories(tuple(effects), arrays, h)


@functools.lru_cache(maxsize=8)  # of long recordings, each takes tens of megabytes
def _memories(effects: tuple[Effect, ...], arrays: tuple[tuple[tuple[int, ...], bytes], ...], h: float) -> Array:
    """See `memories`; asked again and again for the same, of other windows."""
    motor, speed, starts = (np.frombuffer(numbers).reshape(shape) for shape, numbers in arrays)
    kind, names = type(effects[0]), _names(type(effects[0]))
    steps, variants, recordings = motor.shape
    rows = [*effects, *[effects[0]] * (-variants % SHAPE[1])]
    numbers = [np.array([[float(getattr(effect, name))] for effect in rows]) for name in names]
    more = -steps % SHAPE[0], len(rows) - variants, -recordings % SHAPE[2]
    motor = np.pad(motor, [(0, m) for m in more])
    speed = np.pad(speed, [(0, more[0]), (0, more[2])])
    starts = np.pad(starts, [(0, more[1]), (0, more[2]), (0, 0)])
    with jax.enable_x64(True):
        return np.asarray(_along(kind, names)(numbers, motor, speed, starts, h))[: steps + 1, :variants, :recordings]


@functools.lru_cache(maxsize=16)
def _along(kind: type[Effect], names: tuple[str, ...]) -> Callable[..., Traced]:
    """The program of `memories` for a kind of effect."""

    def along(numbers: Sequence[Traced], motor: Traced, speed: Traced, starts: Traced, h: Traced) -> Traced:
        effect: TracedEffect = kind("", **dict(zip(names, numbers, strict=True)))
        first = jnp.broadcast_to(speed[0], motor.shape[1:])

        def step(memory: Memory, now: tuple[Traced, Traced]) -> tuple[Memory, Memory]:
            torque, v = now[0], jnp.broadcast_to(now[1], first.shape)
            with using(Quick()):
                memory = effect.remembered(memory, v, torque, h)
            return memory, memory

        start = tuple(begun + starts[..., i] for i, begun in enumerate(effect.begin_compiled(first)))
        after = jax.lax.scan(step, start, (motor, speed))[1]
        path = [jnp.concatenate([a[None], b]) for a, b in zip(start, after, strict=True)]
        return jnp.stack(path, axis=-1)

    return jax.jit(along)
