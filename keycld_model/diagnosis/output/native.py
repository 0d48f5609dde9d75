"""Which effects MuJoCo has itself, and as which numbers of a model."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco

from keycld_envs.effects import Effect, edited
from keycld_envs.effects.native import NativeModel


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
    names = list(dict.fromkeys(e.where for e in effects if e.kind == "actuator"))
    motors = {name: _chain(model, effects, name) for name in names}
    chained = [e for chain in motors.values() for e in chain]
    chosen = [e for e in effects if e in chained or (e.kind != "actuator" and e.native(model))]
    target = NativeModel(edited(model, [e for e in chosen if e.only_edits]))
    for effect in (*(e for e in chosen if e not in chained and not e.only_edits), *chained):
        effect.write(target)
    for name, gain in target.gains.items():
        target.model.actuator_gainprm[target.model.actuator(name).id] *= gain
    return Native(target.model, chosen, [e for e in effects if e not in chosen], target.attributes)


def _chain(model: mujoco.MjModel, effects: Sequence[Effect], name: str) -> list[Effect]:
    """The last effects of an actuator, as far as MuJoCo has them in that order, each kind once."""
    out: list[Effect] = []
    own = [e for e in effects if e.where == name and e.kind == "actuator"]
    kinds = [type(e) for e in own]
    for effect in reversed(own):
        if kinds.count(type(effect)) > 1 or not effect.native(model, out):
            break
        out.insert(0, effect)
    return out
