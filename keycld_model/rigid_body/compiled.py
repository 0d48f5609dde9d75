"""Thousands of short rollouts of a tree of hinges and slides at once, as MuJoCo steps it, compiled by JAX.

A search needs many millions of steps; `examples/rollout_speed.py` compares with MuJoCo's own batched rollouts. The
integrators are those of MuJoCo's documentation ("Computation").
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.rigid_body.effects import EffectSlots, residual_numbers
from keycld_model.rigid_body.engine import Copies
from keycld_model.rigid_body.equations import (
    TreeNumbers,
    acceleration,
    actuator_torque,
    balance,
    bearing_force,
    motor_torque,
)
from keycld_model.rigid_body.friction import exact_stiction
from keycld_model.rigid_body.residual_force import AnyArray
from keycld_model.rigid_body.scalars import Traced
from keycld_model.rigid_body.tree import RigidBodyTree

Array = NDArray[np.float64]
CHUNK, PIECE = 128, 40
"""Rollouts, and steps at most, that are simulated together: any other numbers would be compiled anew."""


@dataclass(frozen=True)
class CompiledBatch:
    """Rollouts, in chunks of one size.

    Attributes:
        slots: for effects.
        chunks: numbers `[K, N]` of the mechanism and of effects, and what effects remember at first, `[M, N]`.
        residual: numbers of a residual force; empty if there is none.
        step: s.
    """

    slots: EffectSlots
    chunks: list[tuple[Array, Array]]
    residual: tuple[AnyArray, ...]
    step: float


class CompiledEngine:
    """An engine of compiled steps; see `Engine`."""

    def __init__(self, tree: RigidBodyTree) -> None:
        self.tree = tree
        self._programs = _programs(tree)
        self._known: dict[frozenset[type[Effect]], EffectSlots] = {}

    @classmethod
    def of(cls, model: mujoco.MjModel, exact_stiction: bool = False) -> "CompiledEngine | None":
        """None for models that only MuJoCo can step; see `RigidBodyTree.of`."""
        tree = RigidBodyTree.of(model, exact_stiction)
        return None if tree is None else cls(tree)

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return self.tree.size

    @property
    def motion(self) -> slice:
        """Where positions and velocities are in it."""
        return slice(0, self.tree.size)

    def batch(self, copies: Copies) -> CompiledBatch:
        """Rollouts that are ready to be run."""
        everything = [effect for some in copies.applied for effect in some.effects]
        slots, windows = self._slots(copies.models[0], everything), int(copies.window.max()) + 1
        rows = [
            np.concatenate([self.tree.numbers(model), slots.numbers(some.effects)])
            for model, some in zip(copies.models, copies.applied, strict=True)
        ]
        memory = np.stack([slots.remembered(some, windows) for some in copies.applied])[copies.of, copies.window]
        numbers, step = np.stack(rows)[copies.of], float(copies.models[0].opt.timestep)
        chunks = [(numbers[some].T, memory[some].T) for some in _chunks(len(numbers))]
        return CompiledBatch(slots, chunks, residual_numbers(everything), step)

    def _slots(self, model: mujoco.MjModel, effects: Sequence[Effect]) -> EffectSlots:
        """Slots that take some effects; these are the same for all variants of a model."""
        kinds = frozenset(map(type, effects))
        if kinds not in self._known:
            self._known[kinds] = EffectSlots.of(model, effects)
        return self._known[kinds]

    def run(self, batch: CompiledBatch, state: Array, control: Array, time: Array) -> Array:
        """States after every step, `[N, S, size]`; see `Engine`."""
        (n, steps, _), roll = control.shape, self._programs(batch.slots)
        out, at = np.empty((n, steps, self.size)), 0
        with jax.enable_x64(True):
            for (numbers, memory), some in zip(batch.chunks, _chunks(n), strict=True):
                motion, used = _at_first(state[some].T, memory, time[some]), min(CHUNK, n - at)
                for begin in range(0, steps, PIECE):
                    end = min(begin + PIECE, steps)
                    commands = np.zeros((PIECE, control.shape[2], CHUNK))
                    commands[: end - begin] = np.moveaxis(control[some, begin:end], 0, -1)
                    motion, path = roll(numbers, motion, commands, end - begin, batch.step, batch.residual)
                    out[at : at + used, begin:end] = np.moveaxis(np.asarray(path)[: end - begin], -1, 0)[:used]
                at += used
        return out


Numbers = TypeVar("Numbers", Array, Traced)


class Motion(NamedTuple, Generic[Numbers]):
    """Where N rollouts are.

    Attributes:
        q: `[nv, N]`.
        v: `[nv, N]`.
        before: velocities one step before.
        memory: `[M, N]` of effects.
        time: `[N]` s, for effects.
    """

    q: Numbers
    v: Numbers
    before: Numbers
    memory: Numbers
    time: Numbers


def _at_first(state: Array, memory: Array, time: Array) -> Motion[Array]:
    """Where rollouts are that begin with states `[2 nv, N]`."""
    q, v = np.split(state, 2)
    return Motion(q, v, v, memory, time)


class Program(Protocol):
    """Compiled steps of N rollouts."""

    def __call__(
        self,
        numbers: Array,
        motion: Motion[Array] | Motion[Traced],
        control: Array,
        steps: int,
        h: float,
        residual: tuple[AnyArray, ...],
    ) -> tuple[Motion[Traced], Traced]:
        """Where the rollouts are after their steps, and their states `[S, 2 nv, N]`.

        Args:
            numbers: `[K, N]` of the mechanism and of effects.
            motion: where they are.
            control: `[S, nu + nv, N]` commands and forces from outside.
            steps: how many are wanted, S at most.
            h: s per step.
            residual: numbers of a residual force.
        """
        ...


def _chunks(number: int) -> list[NDArray[np.int64]]:
    """Indices in pieces of one size, the last one filled up."""
    return [np.minimum(np.arange(at, at + CHUNK), number - 1) for at in range(0, number, CHUNK)]


@functools.lru_cache(maxsize=8)
def _programs(tree: RigidBodyTree) -> Callable[[EffectSlots], Program]:
    """Programs of equal trees, by their slots for effects.

    The last ones used: each takes memory, and some of the mappings of which a process may have 65,530 on Linux.
    """
    return functools.lru_cache(maxsize=32)(functools.partial(_program, tree))


def _program(tree: RigidBodyTree, slots: EffectSlots) -> Program:
    """Steps of a tree with slots for effects."""
    integrate, nu = _runge_kutta if tree.runge_kutta else _euler, len(tree.motors)

    def roll(
        numbers: Traced,
        motion: Motion[Traced],
        control: Traced,
        steps: Traced,
        h: Traced,
        residual: tuple[Traced, ...],
    ) -> tuple[Motion[Traced], Traced]:
        mine, others = jnp.split(numbers, [tree.length])
        own, effects = TreeNumbers.of(tree, mine), slots.traced(others, residual)

        def advance(i: Traced, carry: tuple[Motion[Traced], Traced]) -> tuple[Motion[Traced], Traced]:
            (q, v, before, memory, t), path = carry
            u, middle, gain = control[i], t + h / 2, (v - before) / h
            half_q, half_v = q + 0.5 * h * v + 0.125 * h**2 * gain, v + 0.5 * h * gain
            here = _with_fading_friction(tree, own, half_v)
            if slots.slots:
                bodies, gravity = effects.surroundings(own.bodies, own.gravity, middle)
                bearing = bearing_force(tree, own, half_q, half_v, u)
                motor = actuator_torque(tree, own, half_q, half_v, u)
                friction = effects.dry_friction(here.friction, half_q, half_v, bearing, motor)
                here = here._replace(bodies=bodies, gravity=gravity, friction=friction)
                force, memory = effects.forces(memory, middle, half_q, half_v, u[:nu], motor_torque(here, u), h)
                u = jnp.concatenate([u[:nu], u[nu:] + force])
            if tree.exact_stiction:
                system = lambda: balance(tree, here, half_q, half_v, u).tightened()  # noqa: E731
                u = jnp.concatenate([u[:nu], u[nu:] + exact_stiction(system, here.friction, v, h)])
            after, speed = integrate(tree, here, (q, v), u, h)
            return Motion(after, speed, v, memory, t + h), path.at[i].set(jnp.concatenate([after, speed]))

        path = jnp.zeros((len(control), tree.size, numbers.shape[1]))
        return jax.lax.fori_loop(0, steps, advance, (motion, path))

    return jax.jit(roll)


def _with_fading_friction(tree: RigidBodyTree, numbers: TreeNumbers, v: Traced) -> TreeNumbers:
    """With the dry friction of a joint model that fades with speed, at joints whose friction loss is not taken away."""
    if tree.learned is None:
        return numbers
    more = jnp.where(numbers.friction > 0, tree.learned.fading_friction(v), 0.0)
    return numbers._replace(friction=numbers.friction + more)


def _runge_kutta(
    tree: RigidBodyTree, numbers: TreeNumbers, state: tuple[Traced, Traced], u: Traced, h: Traced
) -> tuple[Traced, Traced]:
    """Positions and velocities after a step of the classical method of fourth order."""
    q, v = state

    def stage(
        carry: tuple[tuple[Traced, Traced], tuple[Traced, Traced]], weights: tuple[Traced, Traced]
    ) -> tuple[tuple[tuple[Traced, Traced], tuple[Traced, Traced]], None]:
        before, total = carry
        ahead, share = weights
        here = q + h * ahead * before[0], v + h * ahead * before[1]
        slope = here[1], acceleration(tree, numbers, *here, u)
        return (slope, jax.tree.map(lambda t, s: t + share * s, total, slope)), None

    zero = jnp.zeros_like(q), jnp.zeros_like(v)
    weights = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6
    (_, total), _ = jax.lax.scan(stage, (zero, zero), weights, unroll=2)
    return q + h * total[0], v + h * total[1]


def _euler(
    tree: RigidBodyTree, numbers: TreeNumbers, state: tuple[Traced, Traced], u: Traced, h: Traced
) -> tuple[Traced, Traced]:
    """Positions and velocities after a semi-implicit step, with implicit damping."""
    q, v = state
    v = v + h * acceleration(tree, numbers, q, v, u, implicit=h)
    return q + h * v, v
