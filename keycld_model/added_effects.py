"""Named effects beside a learned Lagrangian: what commands become, and forces on keypoints.

Effects speak of joints, in SI units; the model speaks of keypoints, and knows (M, V, g) up to a common factor. Joint
positions are functions q(x) of the keypoints, so that a torque t at the joints is the force s (dq/dx)' t on them: it
has the power t'qd in every motion. With the factor s, learned motors have the power of the declared ones.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs.effects import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorLag,
    ActuatorSaturation,
    AsymmetricFriction,
    Cogging,
    ConstantForce,
    CoulombFriction,
    Effect,
    GravityTilt,
    PositionDependentFriction,
    QuadraticDrag,
    Spring,
    StribeckFriction,
    ViscousFriction,
    edited,
)
from keycld_envs.effects.added_physics import check_numbers
from keycld_envs.effects.edited import torque_per_command
from keycld_envs.effects.places import ActuatorEffect, JointEffect
from keycld_envs.errors import InputError
from keycld_envs.systems import System
from keycld_model.joints import joint_positions
from keycld_model.numerics import bounded_minimum
from keycld_model.physics import PointMasses

Floats = NDArray[np.floating]
FRICTION = (
    ViscousFriction,
    CoulombFriction,
    StribeckFriction,
    QuadraticDrag,
    AsymmetricFriction,
    PositionDependentFriction,
)
MOTORS = (ActuatorGain, ActuatorSaturation, ActuatorDeadZone, ActuatorLag, ActuatorDelay)
TAKEN = (*FRICTION, *MOTORS, Spring, ConstantForce, Cogging, GravityTilt)
"""What can be added to a world model."""
SLOW = 0.02
"""Speed of a joint, rad/s or m/s, below which dry friction may have either direction."""
POSES = 64
"""Configurations in which the powers of motors are compared."""
UNLIKE = 0.3
"""Share of the motors' power that may differ from the declared one, root mean square, before they are others."""


@dataclass(frozen=True, eq=False)
class AddedEffects:
    """Effects beside the Lagrangian of point masses; all functions of states are JAX-traceable.

    Attributes:
        effects: at joints, actuators, and gravity.
        simulator: model of the system without them.
        timestep: seconds for which a command is held.
        points: the learned masses and what holds them.
        joints: positions `[nq]` of joints, rad or m, of keypoints `[n]`.
        scale: `[nq]` learned power per W, of each joint.
        weights: `[K]` learned weights at the keypoints, learned mass x image units/s^2.
    """

    effects: tuple[Effect, ...]
    simulator: mujoco.MjModel
    timestep: float
    points: PointMasses
    joints: Callable[[Array], Array]
    scale: Floats
    weights: Floats

    # Commands -------------------------------------------------------------------------------------------------------

    @property
    def changes_commands(self) -> bool:
        """Motors do not do what they are told."""
        return bool(self._of_actuators)

    @property
    def late(self) -> float:
        """Seconds, for which motors may remember a command, as far as anything comes of it."""
        numbers = [(p, getattr(e, p.name)) for e in self._of_actuators for p in e.parameters()]
        return float(sum(value * (10.0 if p.name == "lag" else 1.0) for p, value in numbers if p.unit == "s"))

    def at_motors(self, actions: Floats) -> Floats:
        """What motors make of actions `[T, m]`, the first of which held before: `[T, m]`, means over steps."""
        substeps = max(1, round(self.timestep / self.simulator.opt.timestep))
        u = np.repeat(np.asarray(actions, float), substeps, axis=0)
        for effect in self._of_actuators:
            u = effect.command(self.simulator, u, self.timestep / substeps)
        return u.reshape(-1, substeps, u.shape[1]).mean(axis=1)

    # Forces ---------------------------------------------------------------------------------------------------------

    def potential_energy(self, x: Array) -> Array:
        """What gravity that points elsewhere adds to V (scalar), at positions `[n]`."""
        return -jnp.asarray(self.weights) @ (x.reshape(-1, 2) @ self._turned)

    def force(self, x: Array, v: Array) -> Array:
        """Force on keypoints `[n]` of all that is smooth in the state, beside the potential."""
        slope, q, qd = self._joint_state(x, v)
        damping, polynomial = self._damping
        torque = jnp.asarray(-damping * qd)
        for power, coefficient in enumerate(polynomial.T, start=1):
            torque -= coefficient * qd * jnp.abs(qd) ** power
        for effect in self._of_joints:
            if effect.forces and not effect.has_dry_friction:
                i = effect.dof(self.simulator)
                torque = torque.at[i].add(effect.torque(jnp.zeros(()), q[i], qd[i]))
        return slope.T @ (self.scale * torque)

    def against_friction(self, x: Array, v: Array) -> Array:
        """The acceleration `[n]` that dry friction takes from a motion that is now to go on with velocities `[n]`.

        It opposes every joint that moves; where one hardly does, it is in proportion to its speed.
        """
        if not self.is_dry:
            return jnp.zeros_like(x)
        slope, q, qd = self._joint_state(x, v)
        return self._reply(x, slope) @ (-self._dry(q, qd) * jnp.tanh(qd / SLOW))

    def slowed(self, x: Array, v: Array, step_size: float | Array) -> tuple[Array, Array]:
        """State `[n]`, `[n]` after a step in which there was no dry friction, with it.

        Friction is the force within its bounds that makes the motion least, in the metric of the masses.
        """
        if not self.is_dry:
            return x, v
        slope, q, qd = self._joint_state(x, v)
        reply, most = self._reply(x, slope), self._dry(q, qd)
        push = jax.vmap(self.points.momentum, 1)(reply)
        gram = push @ reply + 1e-9 * jnp.eye(len(most))
        change = step_size * reply @ bounded_minimum(gram, -push @ v / step_size, -most, most)
        return self.points.project(x + 0.5 * step_size * change, v + change, 1)

    @property
    def is_dry(self) -> bool:
        """There is dry friction."""
        return bool(self._friction.any()) or any(e.has_dry_friction for e in self._of_joints)

    def _joint_state(self, x: Array, v: Array) -> tuple[Array, Array, Array]:
        """Slope of joint positions `[nq, n]`, positions `[nq]`, and speeds `[nq]`."""
        slope = jax.jacfwd(self.joints)(x)
        return slope, self.joints(x), slope @ v

    def _reply(self, x: Array, slope: Array) -> Array:
        """Acceleration `[n, nq]` per unit of torque at each joint, at rest."""
        rest = jnp.zeros_like(x)
        return jax.vmap(lambda f: self.points.acceleration(f, x, rest), 0, 1)(self.scale[:, None] * slope)

    def _dry(self, q: Array, qd: Array) -> Array:
        """Greatest dry friction `[nq]`, N m or N."""
        most = jnp.asarray(self._friction)
        for effect in self._of_joints:
            if effect.has_dry_friction:
                i = effect.dof(self.simulator)
                more = effect.dry_friction(q[i], qd[i], lambda: jnp.zeros(()))
                most = most.at[i].add(0.0 if more is None else more)
        return jnp.maximum(most, 0.0)

    # What effects change in the simulator ---------------------------------------------------------------------------

    @property
    def _of_actuators(self) -> list[ActuatorEffect]:
        return [effect for effect in self.effects if isinstance(effect, ActuatorEffect)]

    @property
    def _of_joints(self) -> list[Any]:
        """Their functions take NumPy's arrays, and a compiler's as well."""
        return [effect for effect in self.effects if isinstance(effect, JointEffect)]

    @cached_property
    def _edited(self) -> mujoco.MjModel:
        return edited(self.simulator, [effect for effect in self.effects if not isinstance(effect, ActuatorEffect)])

    def _more(self, name: str) -> Floats:
        return np.asarray(getattr(self._edited, name) - getattr(self.simulator, name))

    @cached_property
    def _damping(self) -> tuple[Floats, Floats]:
        return self._more("dof_damping"), self._more("dof_dampingpoly")

    @cached_property
    def _friction(self) -> Floats:
        return self._more("dof_frictionloss")

    @cached_property
    def _turned(self) -> Floats:
        """[2] direction of gravity now minus before, right and up."""
        before, after = self.simulator.opt.gravity, self._edited.opt.gravity
        return (after - before)[[0, 2]] / max(float(np.linalg.norm(before)), 1e-9)


def added_effects(
    effects: Sequence[Effect],
    system: System,
    timestep: float,
    points: PointMasses,
    potential_energy: Callable[[Array], Array],
    input_matrix: Callable[[Array], Array],
) -> AddedEffects:
    """Effects in the units of a learned model.

    Args:
        effects: of joints, actuators and gravity.
        system: that the model has learned.
        timestep: seconds between frames.
        points: masses and constraints of the model.
        potential_energy: V of positions `[n]`.
        input_matrix: g `[n, m]` of positions `[n]`.

    Raises:
        InputError: if an effect is of another kind or place, or the model's motors are not the system's.
    """
    simulator = system.compile()
    for effect in effects:
        _check(effect, simulator)
    joints, (x, _) = joint_positions(system, points), allowed_states(points)
    scale = power_of_joints(system, points, input_matrix)
    energies = np.asarray(jax.jit(jax.vmap(potential_energy))(x))
    heights = np.asarray(x).reshape(len(x), -1, 2)[..., 1]
    weights = weights_of(np.asarray(points.lumped), heights, energies)
    return AddedEffects(tuple(effects), simulator, timestep, points, joints, scale, weights)


def learned_power(system: System, points: PointMasses, input_matrix: Callable[[Array], Array]) -> float:
    """Learned power of motors per W of those that a system declares.

    Args:
        system: that a model has learned.
        points: masses and constraints of the model.
        input_matrix: g `[n, m]` of positions `[n]`.

    Raises:
        InputError: if the model's motors are not the system's.
    """
    return _of_all_motors(system, *_powers(system, points, input_matrix))


def _of_all_motors(system: System, declared: Floats, learned: Floats) -> float:
    """Learned power per W of motors with powers `[P, m]` as declared and as learned."""
    declared, learned = declared.ravel(), learned.ravel()
    scale = float(declared @ learned / (declared @ declared))
    off = np.sqrt(np.mean((learned - scale * declared) ** 2) / np.mean(learned**2))
    if not off < UNLIKE or scale <= 0:
        raise InputError(
            f"The model's motors do not work at the joints of {system.name!r} as declared (their powers differ by "
            f"{100 * off:.0f} %), so that effects have no place in it; train it longer, or on that system."
        )
    return scale


def power_of_joints(system: System, points: PointMasses, input_matrix: Callable[[Array], Array]) -> Floats:
    """Learned power per W `[nq]`, of each joint: that of its own motor, or of all where it has none of its own.

    The masses of a light link are learned less well than how its own motor moves it, and what is missing at a joint is
    told from that motion. Arguments and errors as in `learned_power`.
    """
    declared, learned = _powers(system, points, input_matrix)
    usual, per_command = _of_all_motors(system, declared, learned), torque_per_command(system.compile())
    own = np.sum(declared * learned, axis=0) / np.maximum(np.sum(declared**2, axis=0), 1e-12)
    works = np.abs(per_command) > 0
    alone = works & (works.sum(axis=0) == 1) & (works.sum(axis=1, keepdims=True) == 1) & (own > 0)
    return np.where(alone.any(axis=1), alone @ own, usual)


def _powers(system: System, points: PointMasses, input_matrix: Callable[[Array], Array]) -> tuple[Floats, Floats]:
    """Power of each motor `[P, m]` per unit of command in some states: as declared, W, and as learned."""
    joints, (x, v) = joint_positions(system, points), allowed_states(points)
    slopes = jax.jit(jax.vmap(jax.jacfwd(joints)))(x)
    declared = np.einsum("pjn,pn,ji->pi", slopes, v, torque_per_command(system.compile()))
    return declared, np.einsum("pni,pn->pi", jax.jit(jax.vmap(input_matrix))(x), v)


def weights_of(masses: Floats, heights: Floats, energies: Floats) -> Floats:
    """Weights `[K]` with which heights `[P, K]` make potential energies `[P]`, up to a constant.

    They need not be in proportion to the masses, since a link's inertia and moment are two numbers. Where heights do
    not tell, they are.
    """
    gravity = np.polyfit(heights @ masses, energies, 1)[0]
    arms, left = heights - heights.mean(axis=0), energies - energies.mean()
    few = 1e-4 * np.trace(arms.T @ arms) * np.eye(len(masses))
    more = np.linalg.solve(arms.T @ arms + few, arms.T @ (left - arms @ masses * gravity))
    return gravity * masses + more


def allowed_states(points: PointMasses) -> tuple[Array, Array]:
    """Configurations `[P, n]` and velocities `[P, n]` that the constraints allow."""
    rng, size = np.random.default_rng(0), 2 * points.mechanism.num_keypoints
    x, v = (jnp.asarray(rng.normal(scale=0.5, size=(POSES, size)), jnp.float32) for _ in range(2))
    project = jax.vmap(lambda x, v: points.project(x, v, 1))
    return jax.jit(lambda x, v: jax.lax.fori_loop(0, 20, lambda _, state: project(*state), (x, v)))(x, v)


def _check(effect: Any, simulator: mujoco.MjModel) -> None:
    """Refuse what has no place beside a world model."""
    if not isinstance(effect, TAKEN):
        names = ", ".join(sorted(kind.id for kind in TAKEN))
        raise InputError(f"{getattr(effect, 'id', effect)!s} cannot be added to a world model, which takes {names}.")
    places = {candidate.where for candidate in type(effect).candidates(simulator)}
    if effect.where not in places:
        raise InputError(f"{effect.id} is at {effect.where!r}; the model has {sorted(places)}.")
    check_numbers(effect)
