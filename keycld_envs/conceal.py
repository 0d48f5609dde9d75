"""Conceals an effect in recordings: mechanism and sensors stay, what is known of the commands changes.

If a motor gave u, and one writes down u + f(q, qd, t) instead, then -f acts and nobody knows.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from keycld_envs.effects.actuator_delay import ActuatorDelay
from keycld_envs.effects.actuator_lag import ActuatorLag
from keycld_envs.effects.base import Effect
from keycld_envs.effects.edited import edited, moments, resistance, torque_per_command
from keycld_envs.effects.places import ActuatorEffect
from keycld_envs.effects.transmission import TransmissionEffect
from keycld_envs.errors import InputError
from keycld_envs.recordings.recording import Recording

Array = NDArray[np.float64]
SMOOTHING = 0.05
"""Seconds over which positions are taken as a polynomial of third order, to have velocities."""
MOST_ROUNDS = 20
"""Times that a force which depends on commands is computed again for the commands without it."""
OTHERS = ("body_mass", "body_inertia", "body_ipos", "dof_armature", "jnt_stiffness")
"""What an effect may not change of a model to be a force against the motion."""


@dataclass(frozen=True)
class Concealed:
    """A recording in which an effect is concealed.

    Attributes:
        recording: with other commands, or another clock of the sensors.
        hidden: `[nv]` root mean square of the force that is not known, N m or N; zeros if clocks were changed.
    """

    recording: Recording
    hidden: Array


def conceal(recording: Recording, model: mujoco.MjModel, effect: Effect) -> Concealed:
    """Conceal an effect in a recording.

    What effects do in time counts from the first sample of the positions.

    Args:
        recording: with joint positions, and commands of all motors.
        model: the simulator.
        effect: with its place and size.

    Returns:
        A recording for which the model with the effect is as good as the model alone is for the one handed in.

    Raises:
        InputError: if the effect cannot be concealed in commands or clocks, as masses, or acts on a joint without a
            motor.
    """
    _check(recording, model, effect)
    if effect.observes:
        return Concealed(_on_other_clock(recording, effect), np.zeros(model.nv))
    if isinstance(effect, ActuatorEffect) and not effect.forces:
        return _in_commands(recording, model, effect)
    return _as_force(recording, model, effect)


def _check(recording: Recording, model: mujoco.MjModel, effect: Effect) -> None:
    who = f"Recording {recording.id!r}"
    if recording.qpos is None or recording.t_state is None or len(recording.t_state) < 10:
        raise InputError(
            f"{who} has fewer than 10 samples of joint positions; conceal effects in recordings with more."
        )
    if recording.qpos.shape[1] != model.nq:
        raise InputError(f"{who} has {recording.qpos.shape[1]} joints, the simulator has {model.nq}.")
    if (recording.action is None or not recording.action.shape[1]) and not effect.observes:
        raise InputError(f"{who} has no commands (action), in which {effect.id} could be concealed.")
    if recording.action is not None and recording.action.shape[1] != model.nu:
        raise InputError(f"{who} has {recording.action.shape[1]} actions, the simulator has {model.nu} actuators.")


def _on_other_clock(recording: Recording, effect: Effect) -> Recording:
    """With times at which a sensor with the effect would have shown the same."""
    t = np.asarray(recording.t_state)
    since = t - t[0]
    at_one, at_zero = effect.observe(np.ones(1))[0], effect.observe(np.zeros(1))[0]
    return replace(recording, t_state=t[0] + (since - at_zero) / (at_one - at_zero))


def _in_commands(recording: Recording, model: mujoco.MjModel, effect: ActuatorEffect) -> Concealed:
    """With commands that a motor with the effect would have needed."""
    i = int(model.actuator(effect.where).id)
    assert recording.qpos is not None
    t, u = np.asarray(recording.t_action), np.asarray(recording.action, np.float64)
    if isinstance(effect, ActuatorDelay):
        times, told = t - effect.d, u[:, i]
    elif isinstance(effect, ActuatorLag):
        times, told = _leading(t, u[:, i], effect.lag)
    else:
        times, told = t, _inverse(effect, u[:, i])
    every = np.union1d(t, times)
    action = np.stack([_held(every, *((times, told) if k == i else (t, u[:, k]))) for k in range(model.nu)], axis=1)
    wrong = _rms(_held(every, t, u[:, i]) - action[:, i])
    hidden = wrong * np.abs(moments(model, np.nan_to_num(recording.qpos[0]))[i] * model.actuator_gainprm[i, 0])
    return Concealed(replace(recording, t_action=every, action=action), hidden)


def _inverse(effect: ActuatorEffect, u: Array) -> Array:
    """Commands for which a motor that answers at once gives u `[T]`, found on the curve of what it gives."""
    if not u.any():
        return u.copy()  # a motor that is told nothing gives nothing
    most = float(np.max(np.abs(u)))
    tried = np.linspace(-20 * most, 20 * most, 400_001)
    given = effect.motor(tried, 1.0)
    low, high = np.searchsorted(given, u, "left"), np.searchsorted(given, u, "right")
    if np.any(np.diff(given) < 0) or given[0] > u.min() or given[-1] < u.max():
        raise InputError(
            f"{effect.id} at {effect.where!r} cannot be concealed: no command gives all that was commanded."
        )
    right = np.interp(u, *_rising(given, tried))
    return np.where((u == 0) & (low < high), 0.0, right)


def _rising(x: Array, y: Array) -> tuple[Array, Array]:
    """Points of a curve where it rises."""
    there = np.concatenate([[True], np.diff(x) > 0]) & np.concatenate([np.diff(x) > 0, [True]])
    return x[there], y[there]


def _leading(t: Array, u: Array, lag: float) -> tuple[Array, Array]:
    """Times and commands for which a motor with a lag gives the commands in the middle of each."""
    middle = np.append((t[1:] + t[:-1]) / 2, t[-1])
    keep = np.exp(-np.diff(middle) / max(lag, 1e-9))
    told = (u[1:] - keep * u[:-1]) / np.maximum(1 - keep, 1e-9)
    return np.concatenate([t[:1], middle]), np.concatenate([u[:1], told, u[-1:]])


def _as_force(recording: Recording, model: mujoco.MjModel, effect: Effect) -> Concealed:
    """With commands that lack the effect's force."""
    t_state, t_action = np.asarray(recording.t_state), np.asarray(recording.t_action)
    every = np.union1d(t_action, t_state[(t_state >= t_action[0]) & (t_state <= t_action[-1])])
    action = np.stack([_held(every, t_action, u) for u in np.asarray(recording.action, np.float64).T], axis=1)
    step = float(np.median(np.diff(every)))
    middle = every + np.append(np.diff(every), step) / 2
    q, v = _motion(recording, middle)
    force, known = np.zeros_like(v), action
    for _ in range(MOST_ROUNDS):  # forces may depend on commands
        before, force = force, hidden_force(effect, model, middle - t_state[0], q, v, known)
        known = action - _commands_of(force, model, effect)
        if np.allclose(force, before, rtol=1e-9, atol=1e-12):
            break
    return Concealed(replace(recording, t_action=every, action=known), np.array([_rms(f) for f in force.T]))


def _commands_of(force: Array, model: mujoco.MjModel, effect: Effect) -> Array:
    """Commands `[T, nu]` for generalised forces `[T, nv]`."""
    out, per_command = np.zeros((len(force), model.nu)), torque_per_command(model)
    for dof in np.flatnonzero(np.any(force != 0, axis=0)):
        if not per_command[dof].any():
            name = model.joint(int(model.dof_jntid[dof])).name
            raise InputError(
                f"{effect.id} at {effect.where!r} acts on the joint {name!r}, which has no motor in whose command it "
                "could be concealed; choose a joint with a motor."
            )
        i = int(np.abs(per_command[dof]).argmax())
        out[:, i] += force[:, dof] / per_command[dof, i]
    return out


def hidden_force(effect: Effect, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
    """Generalised force `[T, nv]` of an effect along a motion, N m or N.

    Args:
        effect: a force, friction and damping that it adds to a model, or gravity that it turns.
        model: the simulator.
        t: `[T]` times, s.
        q: `[T, nq]` positions.
        v: `[T, nv]` velocities.
        u: `[T, nu]` commands.

    Raises:
        InputError: if the effect changes a model in other ways.
    """
    after = edited(model, [effect])
    between = isinstance(effect, TransmissionEffect)
    unlike = [name for name in OTHERS if not np.allclose(getattr(after, name), getattr(model, name), rtol=1e-12)]
    if between or unlike:
        raise InputError(
            f"{effect.id} at {effect.where!r} is no force that a motor could have given; what can be concealed are "
            "forces at joints with motors, errors of motors, and errors of the sensors' clock. A mass or an inertia is "
            "concealed by a simulator in which it is another."
        )
    out = resistance(model, after, v) + _weight(after, q) - _weight(model, q)
    if not effect.memory:
        return out + effect.force(model, t, q, v, u)
    memory, steps = effect.begin(model, v[0]), np.diff(t, append=2 * t[-1] - t[-2])
    for k, h in enumerate(steps):
        force, memory = effect.advance(model, memory, t[k], q[k], v[k], u[k], float(h))
        out[k] += force
    return out


def _weight(model: mujoco.MjModel, q: Array) -> Array:
    """Generalised force of gravity `[T, nv]`, N m or N."""
    data, out = mujoco.MjData(model), np.zeros((len(q), model.nv))
    for k, at in enumerate(q):
        data.qpos[:] = at
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, out[k])
    return -out


def _motion(recording: Recording, times: Array) -> tuple[Array, Array]:
    """Positions and velocities `[T, nq]` at times; velocities from positions, made smooth, if none were measured."""
    t, q = np.asarray(recording.t_state), np.asarray(recording.qpos, np.float64)
    step = max(float(np.median(np.diff(t))), 1e-6)
    even = t[0] + step * np.arange(round((t[-1] - t[0]) / step) + 1)
    window = min(max(5, 2 * round(SMOOTHING / step / 2) + 1), (len(even) - 1) // 2 * 2 + 1)
    along = np.stack([_interpolated(even, t, x) for x in q.T])
    smooth = [np.asarray(savgol_filter(along, window, 3, deriv=deriv, delta=step)) for deriv in (0, 1)]
    at = [np.stack([np.interp(times, even, x) for x in derivative], axis=1) for derivative in smooth]
    if recording.qvel is not None:
        at[1] = np.stack([_interpolated(times, t, x) for x in np.asarray(recording.qvel, np.float64).T], axis=1)
    return at[0], at[1]


def _interpolated(times: Array, t: Array, x: Array) -> Array:
    """At times, between samples that are there."""
    there = np.isfinite(x)
    return np.interp(times, t[there], x[there])


def _held(times: Array, t: Array, u: Array) -> Array:
    """Commands at times; each holds until the next, the first from ever."""
    return u[np.maximum(np.searchsorted(t, times, "right") - 1, 0)]


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
