"""Effects that push, inside the compiled steps of a mechanism.

A program has a slot for every effect of its kinds at every place, so that programs are few: what is absent has numbers
that make it nothing.
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

from keycld_envs.effects import (
    EFFECTS,
    BaseMotion,
    Effect,
    GainDrift,
    HystereticFriction,
    LoadDependentFriction,
    MassDrift,
)
from keycld_envs.effects.base import LIGHTEST, ActuatorEffect, JointEffect, TransmissionEffect, using
from keycld_model.rigid_body.residual_force import Features, ResidualForce
from keycld_model.rigid_body.scalars import Quick

Array = NDArray[np.float64]


def _pushes_a_joint(kind: type[Effect]) -> bool:
    return issubclass(kind, JointEffect) and kind.torque is not JointEffect.torque


LIGHT = tuple(
    kind
    for kind in EFFECTS.values()
    if _pushes_a_joint(kind) or kind in (HystereticFriction, BaseMotion, MassDrift, GainDrift)
)
"""Cheap enough to be in every program with effects."""
HEAVY = (
    tuple(kind for kind in EFFECTS.values() if issubclass(kind, TransmissionEffect)),
    (LoadDependentFriction,),
)
"""In a program only if some variant has one of the group."""


SHAPE = 256, 16, 8
"""Steps, variants and recordings are filled up to multiples of these where memories are computed."""


@dataclass(frozen=True)
class Slot:
    """Where an effect can be.

    Attributes:
        absent: the effect, with numbers that make it nothing.
        at: index of its joint, body (the world is no body) or axis of the world.
        motor: index of its actuator, or -1.
    """

    absent: Effect
    at: int
    motor: int = -1

    @property
    def key(self) -> tuple[str, str]:
        """What, and where."""
        return self.absent.key

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Of its numbers."""
        return tuple(f.name for f in fields(self.absent) if f.name != "where")

    def numbers(self, effect: Effect) -> list[float]:
        """Those of an effect."""
        return [float(getattr(effect, name)) for name in self.names]

    def filled(self, numbers: Any) -> Any:
        """The effect with these numbers, each `[N]`."""
        return replace(self.absent, **dict(zip(self.names, numbers, strict=True)))


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
    """All of a program, and which joints turn if it has a residual force."""

    slots: tuple[Slot, ...] = ()
    turning: tuple[bool, ...] | None = None

    @classmethod
    def of(cls, model: mujoco.MjModel, effects: Iterable[Effect]) -> "EffectSlots":
        """What takes some effects; empty if there are none."""
        kinds = {type(effect) for effect in effects}
        if not kinds:
            return cls()
        turning = tuple(bool(t == mujoco.mjtJoint.mjJNT_HINGE) for t in model.jnt_type)
        out = {}
        for kind in itertools.chain(LIGHT, *(group for group in HEAVY if kinds.intersection(group))):
            for effect in kind.candidates(model):
                slot = _slot(model, effect)
                out.setdefault(slot.key, slot)
        return cls(tuple(out.values()), turning if ResidualForce in kinds else None)

    def numbers(self, effects: Sequence[Effect]) -> Array:
        """Those of some effects, `[K]`."""
        here = {effect.key: effect for effect in effects}
        return np.array([x for slot in self.slots for x in slot.numbers(here.get(slot.key, slot.absent))])

    def remembered(self, pushing: AppliedEffects, windows: int) -> Array:
        """Memories at the starts of windows, `[W, M]`."""
        pairs = zip(pushing.effects, pushing.memories, strict=True)
        here = {effect.key: memory for effect, memory in pairs}
        empty = np.zeros((windows, 0))
        parts = [here.get(slot.key, np.zeros((windows, slot.absent.memory))) for slot in self.slots]
        return np.concatenate([empty, *parts], axis=1)

    def traced(self, numbers: Any, smooth: tuple[Any, ...]) -> "TracedEffects":
        """With numbers `[K, N]` and those of a residual force, while a program is traced."""
        ends = np.cumsum([len(slot.names) for slot in self.slots])[:-1]
        pieces = jnp.split(numbers, ends) if self.slots else []
        filled = [(slot, slot.filled(list(piece))) for slot, piece in zip(self.slots, pieces, strict=True)]
        if self.turning is None:
            return TracedEffects(filled, None)
        *features, weights = smooth
        return TracedEffects(filled, (Features(np.array(self.turning), *features), weights))


def compiles(effect: Effect) -> bool:
    """Whether an effect that pushes can be in a program."""
    return type(effect) in itertools.chain(LIGHT, *HEAVY, (ResidualForce,))


def residual_numbers(effects: Iterable[Effect]) -> tuple[Array, ...]:
    """Those of the one residual force among effects; empty if there is none.

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


def _slot(model: mujoco.MjModel, effect: Effect) -> Slot:
    if isinstance(effect, ActuatorEffect):
        return Slot(effect, effect.dof(model), int(model.actuator(effect.where).id))
    if isinstance(effect, JointEffect):
        return Slot(effect, effect.dof(model))
    if isinstance(effect, BaseMotion):
        return Slot(effect, effect.axis)
    return Slot(effect, int(model.body(effect.where).id) - 1)


@dataclass(frozen=True)
class TracedEffects:
    """Effects while a program is traced; every number is an array over N rollouts.

    Attributes:
        effects: in their slots.
        smooth: features and weights of a residual force, of all rollouts.
    """

    effects: list[tuple[Slot, Any]]
    smooth: tuple[Features, Any] | None

    def surroundings(self, bodies: Any, gravity: Any, t: Any) -> tuple[Any, list[Any]]:
        """Numbers of bodies `[nb, 10, N]` and gravity, at times `[N]`."""
        gravity = list(gravity)
        with using(Quick()):
            for slot, effect in self.effects:
                if isinstance(effect, BaseMotion):
                    gravity[slot.at] = gravity[slot.at] - effect.acceleration(t)
                elif isinstance(effect, MassDrift):
                    heavy = jnp.array([0, 4, 5, 6])  # mass and moments of inertia
                    bodies = bodies.at[slot.at, heavy].multiply(effect.factor(t))
        return bodies, gravity

    def dry_friction(self, friction: Any, q: Any, v: Any, load: Callable[[int], Any]) -> Any:
        """Dry friction `[nv, N]` with that of effects, for positions, velocities, and forces in bearings of joints."""
        with using(Quick()):
            for slot, effect in self.effects:
                if isinstance(effect, JointEffect) and effect.rubs:
                    more = effect.dry(q[slot.at], v[slot.at], functools.partial(load, slot.at))
                    friction = friction.at[slot.at].add(more)
        return jnp.maximum(friction, 0.0)

    def forces(
        self,
        memory: Any,
        t: Any,
        q: Any,
        v: Any,
        u: Any,
        motor: Callable[[int], Any],
        h: Any,
    ) -> tuple[Any, Any]:
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
        with using(Quick()):
            force, left, after = [jnp.zeros_like(x) for x in v], iter(memory), []
            if self.smooth is not None:
                features, weights = self.smooth
                force = list((features(q.T, v.T, u.T) @ weights).T)
            for slot, effect in self.effects:
                at, push = slot.at, None
                if isinstance(effect, HystereticFriction):
                    push, bent = effect.rub(next(left), v[at], h)
                    after.append(bent)
                elif isinstance(effect, TransmissionEffect):
                    push, rotor = _transmitted(effect, (next(left), next(left)), motor(slot.motor), v[at], h)
                    after.extend(rotor)
                elif isinstance(effect, GainDrift):
                    push = effect.change(t, motor(slot.motor))
                elif isinstance(effect, JointEffect) and not effect.rubs:
                    push = effect.torque(t, q[at], v[at])
                if push is not None:
                    force[at] = force[at] + push
        return jnp.stack(force), jnp.stack(after) if after else memory


def _transmitted(effect: TransmissionEffect, memory: Any, motor: Any, speed: Any, h: Any) -> Any:
    """See `TransmissionEffect.transmit`; its many substeps only where some rollout has a rotor."""
    return jax.lax.cond(
        jnp.any(effect.rotor >= LIGHTEST),
        lambda: effect.transmit(memory, motor, speed, h),
        lambda: (jnp.zeros_like(speed), memory),
    )


def memories(effects: Sequence[Any], motor: Array, speed: Array, starts: Array, h: float) -> Array:
    """What effects of one kind remember along recordings, `[T + 1, V, R, memory]`.

    Args:
        effects: V of them, with a memory, at one place.
        motor: torque of the actuator there, if any, at T steps of R recordings, `[T, V, R]`.
        speed: of the joint there, `[T, R]`.
        starts: what they remember at first, beyond where they begin, `[V, R, memory]`.
        h: s per step.
    """
    kind, names = type(effects[0]), Slot(effects[0], 0).names
    steps, variants, recordings = motor.shape
    rows = [*effects, *[effects[0]] * (-variants % SHAPE[1])]  # few shapes, for each is compiled
    numbers = [np.array([[float(getattr(effect, name))] for effect in rows]) for name in names]
    more = -steps % SHAPE[0], len(rows) - variants, -recordings % SHAPE[2]
    motor = np.pad(motor, [(0, m) for m in more])
    speed = np.pad(speed, [(0, more[0]), (0, more[2])])
    starts = np.pad(starts, [(0, more[1]), (0, more[2]), (0, 0)])
    with jax.enable_x64(True):
        return np.asarray(_along(kind, names)(numbers, motor, speed, starts, h))[: steps + 1, :variants, :recordings]


@functools.lru_cache(maxsize=16)
def _along(kind: type[Effect], names: tuple[str, ...]) -> Any:
    def along(numbers: Any, motor: Any, speed: Any, starts: Any, h: Any) -> Any:
        effect: Any = kind("", **dict(zip(names, numbers, strict=True)))
        first = jnp.broadcast_to(speed[0], motor.shape[1:])

        def step(memory: Any, now: Any) -> Any:
            torque, v = now[0], jnp.broadcast_to(now[1], first.shape)
            with using(Quick()):
                if kind is HystereticFriction:
                    memory = effect.rub(memory, v, h)[1]
                else:
                    memory = effect.transmit(memory, torque, v, h)[1]
            return memory, memory

        begun = effect.slipping(first) if kind is HystereticFriction else (jnp.zeros_like(first), first)
        leaves, tree = jax.tree.flatten(begun)
        start = jax.tree.unflatten(tree, [leaf + starts[..., i] for i, leaf in enumerate(leaves)])
        after = jax.lax.scan(step, start, (motor, speed))[1]
        path = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, after)
        return jnp.stack(jax.tree.leaves(path), axis=-1)

    return jax.jit(along)
