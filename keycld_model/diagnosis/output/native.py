"""Which effects MuJoCo has itself, and as which numbers of a model."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from keycld_envs.effects import ActuatorDelay, ActuatorGain, ActuatorLag, ActuatorSaturation, Effect, Spring
from keycld_model.diagnosis.verdict.evidence import with_effects

MOTOR = (ActuatorGain, ActuatorSaturation, ActuatorLag, ActuatorDelay)
"""What MuJoCo's actuators can do."""


@dataclass
class Native:
    """A model with effects in its numbers.

    Attributes:
        model: compiled.
        effects: that it has.
        others: that have to be added when it is simulated, before its own in the order of the commands.
        actuators: attributes of actuators by name, which change the size of a model's state.
    """

    model: mujoco.MjModel
    effects: list[Effect]
    others: list[Effect]
    actuators: dict[str, dict[str, str]] = field(default_factory=dict)


def native(model: mujoco.MjModel, effects: Sequence[Effect]) -> Native:
    """Write as many effects as possible into a copy of a model.

    An effect that is partly a number of the model and partly more, as Stribeck friction, counts as none: its class
    adds both parts.
    """
    motors = [e for name in {e.where for e in effects if e.kind == "actuator"} for e in _chain(model, effects, name)]
    chosen = [e for e in effects if e in motors or isinstance(e, Spring) or _edits_only(e)]
    out = Native(with_effects(model, [e for e in chosen if _edits_only(e)]), chosen, [])
    out.others = [e for e in effects if e not in chosen]
    for effect in chosen:
        if isinstance(effect, Spring):
            _spring(out.model, effect)
    for name in {e.where for e in motors}:
        _motor(out, name, [e for e in motors if e.where == name])
    return out


def _edits_only(effect: Effect) -> bool:
    """Its numbers in the model are all there is to it."""
    kind = type(effect)
    edits, commands = kind.edit is not Effect.edit, isinstance(effect, MOTOR) or effect.kind == "actuator"
    return edits and not (effect.forces or effect.observes or commands)


def _chain(model: mujoco.MjModel, effects: Sequence[Effect], name: str) -> list[Effect]:
    """The last effects of an actuator, as far as MuJoCo has them in that order."""
    out: list[Effect] = []
    kinds = [type(e) for e in effects if e.where == name and e.kind == "actuator"]
    i = model.actuator(name).id
    still, delayed = model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE, model.actuator_delay[i] > 0
    linear = model.actuator_gaintype[i] <= int(mujoco.mjtGain.mjGAIN_AFFINE)
    impossible = {ActuatorGain: not linear, ActuatorLag: not still, ActuatorDelay: delayed}
    for effect in reversed([e for e in effects if e.where == name and e.kind == "actuator"]):
        saturates_after_lag = isinstance(effect, ActuatorLag) and any(isinstance(e, ActuatorSaturation) for e in out)
        twice = kinds.count(type(effect)) > 1
        if not isinstance(effect, MOTOR) or twice or saturates_after_lag or impossible.get(type(effect)):
            break
        out.insert(0, effect)
    return out


def _spring(model: mujoco.MjModel, spring: Spring) -> None:
    """Add to the joint's stiffness; the two rest where their torques cancel."""
    joint = model.joint(spring.where)
    i, q = joint.id, int(joint.qposadr[0])
    own = float(model.jnt_stiffness[i])
    stiffness = own + spring.k
    model.qpos_spring[q] = (own * model.qpos_spring[q] + spring.f) / stiffness if stiffness else 0.0
    model.jnt_stiffness[i] = stiffness


def _motor(out: Native, name: str, effects: Sequence[Effect]) -> None:
    """Gain and limits as numbers, delay and lag as attributes.

    The stages of a Runge-Kutta step look half a step ahead on average, which the delay makes up for.
    """
    model, i, attributes, gain = out.model, out.model.actuator(name).id, {}, 1.0
    step, stages = model.opt.timestep, model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    for effect in effects:
        if isinstance(effect, ActuatorGain):
            gain *= effect.k
        elif isinstance(effect, ActuatorSaturation):
            low, high = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
            limit = effect.s / max(gain, 1e-9)
            model.actuator_ctrlrange[i], model.actuator_ctrllimited[i] = (max(low, -limit), min(high, limit)), 1
        elif isinstance(effect, ActuatorLag) and effect.lag > 0:
            kind = "filter" if stages and effect.lag > step else "filterexact"
            attributes |= {"dyntype": kind, "dynprm": repr(float(effect.lag))}
        elif isinstance(effect, ActuatorDelay) and effect.d > 0:
            late = float(effect.d + (step / 2 if stages else 0.0))
            attributes |= {"delay": repr(late), "nsample": str(int(np.ceil(late / step)) + 2), "interp": "linear"}
    model.actuator_gainprm[i] *= gain
    if attributes:
        out.actuators[name] = attributes
