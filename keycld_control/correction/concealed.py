"""Physics to conceal in a mechanism, drawn by seed: with it, an agent that does not know of it mostly fails."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs import InputError, System
from keycld_envs.effects import (
    ActuatorDelay,
    ActuatorGain,
    CoulombFriction,
    Effect,
    GravityTilt,
    ViscousFriction,
    edited,
)
from keycld_envs.effects.edited import torque_per_command

Drawn = Callable[[np.random.Generator, str, str, float], Effect]
USUAL_SPEED = 5.0
"""rad/s or m/s at which viscous friction is compared with the motor."""
RESERVE = 0.85
"""Share of a motor's torque that friction and weight at the target may take together."""
TRIES = 50
"""Combinations that are drawn before the mechanism is given up."""


def _delay(rng: np.random.Generator, joint: str, motor: str, torque: float) -> Effect:
    return ActuatorDelay(motor, float(rng.uniform(0.03, 0.09)))


def _gain(rng: np.random.Generator, joint: str, motor: str, torque: float) -> Effect:
    return ActuatorGain(motor, float(rng.uniform(0.3, 0.6)))


def _coulomb(rng: np.random.Generator, joint: str, motor: str, torque: float) -> Effect:
    return CoulombFriction(joint, float(torque * rng.uniform(0.1, 0.3)))


def _viscous(rng: np.random.Generator, joint: str, motor: str, torque: float) -> Effect:
    return ViscousFriction(joint, float(torque / USUAL_SPEED * rng.uniform(0.1, 0.3)))


def _tilt(rng: np.random.Generator, joint: str, motor: str, torque: float) -> Effect:
    return GravityTilt("world", float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.4)))


KINDS: tuple[Drawn, ...] = (_delay, _gain, _coulomb, _viscous, _tilt)


def draw(system: System, seed: int, attempt: int) -> tuple[Effect, ...]:
    """One or two effects, at most one of a kind; attempt i depends on the seed and i only.

    Args:
        system: where they are.
        seed: of the combination.
        attempt: number of the draw, from 0.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(attempt,)))
    model = system.compile()
    names = {int(model.actuator_trnid[i, 0]): model.actuator(i).name for i in range(model.nu)}
    strength = _strength(system, model)
    out = []
    for kind in rng.permutation(len(KINDS))[: rng.integers(1, 3)]:
        joint = int(rng.choice(sorted(names)))
        torque = float(strength[model.jnt_dofadr[joint]])
        out.append(KINDS[kind](rng, model.joint(joint).name, names[joint], torque))
    return tuple(out)


def possible(system: System, effects: Sequence[Effect]) -> bool:
    """Whether motors have torque left beside dry friction and the weight at the target."""
    bare = system.compile()
    model = edited(bare, [effect for effect in effects if effect.kind != "actuator"])
    data = mujoco.MjData(model)
    data.qpos[:] = system.target_qpos
    mujoco.mj_forward(model, data)
    strength = _strength(system, bare)
    for effect in effects:
        if isinstance(effect, ActuatorGain):
            strength = strength * np.where(
                torque_per_command(bare)[:, bare.actuator(effect.where).id] != 0, effect.k, 1
            )
    return bool((np.abs(data.qfrc_bias) + model.dof_frictionloss <= RESERVE * strength).all())


def conceal(system: System, seed: int, fails: Callable[[tuple[Effect, ...]], bool]) -> tuple[tuple[Effect, ...], int]:
    """The first combination of a seed that is possible, and with which the uncorrected agent fails.

    Args:
        system: where it is concealed.
        seed: of the combination.
        fails: whether the agent does.

    Returns:
        The effects, and how many possible combinations were passed over, because the agent did not fail.

    Raises:
        InputError: if there is none among the first 50.
    """
    passed = 0
    for attempt in range(TRIES):
        effects = draw(system, seed, attempt)
        if not possible(system, effects):
            continue
        if fails(effects):
            return effects, passed
        passed += 1
    raise InputError(f"Of {TRIES} combinations of effects none makes {system.name!r} fail; name another system.")


def _strength(system: System, model: mujoco.MjModel) -> NDArray[np.floating]:
    """`[nv]` greatest torque of the motors at each joint, N m or N."""
    limit = model.actuator_ctrlrange[:, 1] if system.action_limit is None else np.full(model.nu, system.action_limit)
    return np.abs(torque_per_command(model)) @ limit
