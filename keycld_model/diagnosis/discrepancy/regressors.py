"""What each thing that a simulator may lack does along a motion, to first order: columns of a regression."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import (
    ActuatorDelay,
    ActuatorLag,
    AsymmetricFriction,
    ConstantForce,
    CoulombFriction,
    Effect,
    GearFriction,
    LoadDependentFriction,
    Parameter,
    PositionDependentFriction,
    QuadraticDrag,
    Spring,
    StribeckFriction,
    ViscousFriction,
    edited,
)
from keycld_envs.effects.edited import resistance, torque_per_command
from keycld_envs.effects.places import ActuatorEffect
from keycld_envs.effects.transmission import TransmissionEffect
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.inertias import inertial_columns
from keycld_model.diagnosis.discrepancy.motion import RESTING, Motion, inverse_dynamics, resting
from keycld_model.diagnosis.simulation.places import places_of
from keycld_model.diagnosis.simulation.sampling import interpolated

Array = NDArray[np.float64]
USUAL: tuple[type[Effect], ...] = (
    ViscousFriction,
    CoulombFriction,
    GearFriction,
    ConstantForce,
    QuadraticDrag,
    ActuatorDelay,
)
"""What every mechanism has some of: in both sets of recordings, whatever changed.

No gain of a motor: what masses do, and a friction that is compensated for, looks like one.
"""
IDEALISED: tuple[type[Effect], ...] = (
    AsymmetricFriction,
    LoadDependentFriction,
    PositionDependentFriction,
    Spring,
    StribeckFriction,
    ActuatorLag,
)
"""What all friction and all motors are a little, which the usual terms leave out."""
IDEALISED_SHARE = 0.1
"""Of the forces of the motion, root mean square, that such effects are expected to have."""
USUAL_NUMBERS = ("backward", "c", "f")
"""Parameters of these that usual terms have already."""


@dataclass(frozen=True)
class Term:
    """A number that both sets of recordings share.

    Attributes:
        name: for instance "mass of upper_arm", or an effect with its place.
        column: `[W, r]` fall of whitened residuals per unit.
        spread: standard deviation expected of it; infinite if nothing is known.
        effect: whose first parameter it is; None of inertias and zeros.
        zero: it is the zero of an encoder, which may differ from day to day.
        beyond: it is beyond the simplest forms of friction and motors, which it makes up for in part.
        holds: `[W, nv]` force per unit that holds a joint at rest, N m or N; None if it does not.
    """

    name: str
    column: Array
    spread: float
    effect: Effect | None = None
    zero: bool = False
    beyond: bool = False
    holds: Array | None = None


def answer_of(motion: Motion, effect: Effect) -> Array:
    """Fall of whitened residuals `[W, r]` with an effect as it is."""
    if effect.observes:
        return _clock(motion, effect)
    if isinstance(effect, ActuatorEffect) and not effect.forces:
        return motion.answer_by_step(_motor(motion, effect))
    return motion.answer(force_of(motion, effect))


def can_be_tested(effect: Effect, model: mujoco.MjModel) -> bool:
    """Whether what an effect does is a force along the motion, or a clock.

    What has a rotor of its own is none, nor a motor that does not push in proportion to its command at one joint. What
    drifts in the course of every run is no difference between sets of runs.
    """
    if isinstance(effect, TransmissionEffect) or effect.id == "parameter_drift":
        return False
    if isinstance(effect, ActuatorEffect):
        return bool(torque_per_command(model)[:, model.actuator(effect.where).id].any())
    return True


def force_of(motion: Motion, effect: Effect, v: Array | None = None) -> Array:
    """Generalised forces of an effect along the motion, `[W, S, nv]`, N m or N; at its velocities, or others."""
    model, v = motion.model, motion.vibrating if v is None else v
    if isinstance(effect, ActuatorEffect) and not effect.forces:
        return _motor(motion, effect)
    after = edited(model, [effect])
    out = resistance(model, after, v)
    if not all(np.allclose(getattr(after, n), getattr(model, n), rtol=1e-12, atol=0) for n in _INERTIAL) or (
        not np.array_equal(after.opt.gravity, model.opt.gravity)
    ):
        out = out + motion.required - inverse_dynamics(_without_resistance(after, model), motion.q, motion.v, motion.a)
    if not effect.memory:
        out = out + effect.force(model, motion.time, motion.q, v, motion.u)
        return out * (1 - resting(v)) if _is_dry(effect) else out
    memory, h = effect.begin(model, motion.path[1][:, 0]), motion.problem.simulator.step
    for k in range(motion.windows.steps):
        now = motion.time[:, k], motion.q[:, k], v[:, k], motion.u[:, k]
        force, memory = effect.advance(model, memory, *now, h)
        out[:, k] += force
    return out


def _is_dry(effect: Effect) -> bool:
    return effect.confusable is not None and effect.confusable.group == "dry friction"


HOLDING = ("coulomb_friction", "load_dependent_friction")
"""Dry friction whose size does not hang on the speed."""


def _holding(motion: Motion, effect: Effect, scale: float) -> Array | None:
    """Force over a scale with which dry friction holds joints at rest, `[W, nv]`, N m or N: that of a slow motion."""
    if effect.id not in HOLDING:
        return None
    slow = np.full_like(motion.v, 4 * RESTING)
    return np.mean(np.abs(force_of(motion, effect, slow)), axis=1) / scale


_INERTIAL = ("body_mass", "body_inertia", "body_ipos", "body_pos", "dof_armature", "jnt_stiffness", "qpos_spring")


def _without_resistance(after: mujoco.MjModel, model: mujoco.MjModel) -> mujoco.MjModel:
    """With the damping of another model, since what resists is counted by itself."""
    after.dof_damping[:], after.dof_dampingpoly[:] = model.dof_damping, model.dof_dampingpoly
    return after


def _motor(motion: Motion, effect: ActuatorEffect) -> Array:
    """Change of a motor's torque, `[W, S, nv]`."""
    windows, model = motion.windows, motion.model
    changed = [effect.command(model, u, windows.step) - u for u in windows.commands]
    at = windows.first[:, None] + np.arange(windows.steps)
    rows = [changed[r][np.clip(k, 0, len(changed[r]) - 1)] for r, k in zip(windows.recording, at, strict=True)]
    return np.stack(rows) @ torque_per_command(model).T


def share_of_torque(motion: Motion, effect: ActuatorEffect, windows: NDArray[np.bool_]) -> float:
    """Share of what a motor is told, root mean square, that an effect takes away or adds in some windows `[W]`."""
    lost, told = _motor(motion, effect)[windows], motion.u[windows] @ torque_per_command(motion.model).T
    size = np.sum(lost**2)
    with np.errstate(divide="ignore"):
        return float(np.sqrt(size / np.sum(told[..., np.any(lost, axis=(0, 1))] ** 2))) if size > 0 else 0.0


def _clock(motion: Motion, effect: Effect) -> Array:
    """Change of what sensors show with another clock."""
    windows, step = motion.windows, motion.problem.simulator.step
    begun = windows.begun[:, None]
    since = windows.time - windows.start[:, None]
    then = effect.observe(since + begun) - begun
    inside = np.clip(then, 0.0, windows.steps * step - 1e-9)
    (here, _), (there, speed) = (interpolated(*motion.path, t, step) for t in (since, inside))
    there = there + (then - inside)[..., None] * speed
    measured = np.isfinite(windows.measured)
    return np.where(measured, (there - here) / motion.problem.noise, 0.0).reshape(len(windows), -1)


def shared_terms(motion: Motion, criteria: Criteria, held: bool = False) -> list[Term]:
    """What all recordings have: inertias and zeros a little off, friction, and motors not quite exact.

    Args:
        motion: along which they act.
        criteria: thresholds.
        held: what forces of inertia have in common is held at the simulator's. Between two sets it need not be.
    """
    model = motion.model
    out = [Term(*own) for own in inertial_columns(motion, criteria, held)] + _zeros(motion, criteria)
    for kind in USUAL:
        spread = 0.02 if kind is ActuatorDelay else np.inf  # s
        for absent in places_of(kind, model):
            if can_be_tested(absent, model):
                (number,) = absent.parameters()
                little = absent.with_parameters(**{number.name: number.absent + number.scale})
                column = answer_of(motion, little) / number.scale
                holds = _holding(motion, little, number.scale)
                out.append(Term(f"{absent.id} at {absent.where}", column, spread, absent, holds=holds))
    out += _idealised(motion)
    return [term for term in out if np.any(term.column)]


def _idealised(motion: Motion) -> list[Term]:
    """What friction and motors are beyond the simplest forms, expected to be a share of the forces of the motion."""
    model, out = motion.model, []
    for kind in IDEALISED:
        for absent in places_of(kind, model):
            if not can_be_tested(absent, model):
                continue
            for number in absent.parameters():
                if number.grid or number.name in USUAL_NUMBERS:
                    continue
                spread = spread_of_share(motion, absent, number)
                if np.isfinite(spread):
                    little = absent.with_parameters(**{number.name: number.absent + number.scale})
                    column = answer_of(motion, little) / number.scale
                    name = f"{number.name} of {absent.id} at {absent.where}"
                    holds = _holding(motion, little, number.scale)
                    out.append(Term(name, column, spread, beyond=True, holds=holds))
    return out


def spread_of_share(motion: Motion, absent: Effect, number: Parameter) -> float:
    """Size of a number with which an effect is a share of the forces of the motion; infinite if it does nothing."""
    little = absent.with_parameters(**{number.name: number.absent + number.scale})
    force = np.sqrt(np.mean(force_of(motion, little) ** 2, axis=(0, 1))) / number.scale
    usual = np.sqrt(np.mean(motion.required**2, axis=(0, 1)))
    ratio = usual[force > 0] / force[force > 0]
    return float(IDEALISED_SHARE * ratio.max()) if len(ratio) else np.inf


def _zeros(motion: Motion, criteria: Criteria) -> list[Term]:
    """Zeros of encoders: what they shift by themselves, initial states make up for; gravity acts elsewhere."""
    model, out, little = motion.model, [], 1e-3
    for joint in range(model.njnt):
        q = motion.q.copy()
        q[..., joint] += little
        force = (motion.required - inverse_dynamics(model, q, motion.v, motion.a)) / little
        out.append(Term(f"zero of {model.joint(joint).name}", motion.answer(force), criteria.spreads.zero, zero=True))
    return out
