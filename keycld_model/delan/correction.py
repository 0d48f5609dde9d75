"""A joint model with other masses and more friction."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from keycld_envs.effects import Effect
from keycld_model.delan.config import FRICTIONS, JointConfig
from keycld_model.delan.model import JointModel
from keycld_model.delan.network import Parameters
from keycld_model.delan.sum import part_name

LEAST = 1e-12
"""N m and so on: what friction is where there is none, for its logarithm is stored."""
Values = dict[str, dict[str, np.ndarray]]


def scaled(model: JointModel, factor: float) -> JointModel:
    """All inertias and potential energies times a factor; friction stays."""
    config, equations = _scaled(model.config, model.parameters["equations"], factor)
    return replace(model, config=config, parameters={**model.parameters, "equations": equations})


def _scaled(config: JointConfig, p: Parameters, factor: float) -> tuple[JointConfig, Parameters]:
    if config.family == "least_squares":
        return config, {"coefficients": factor * np.asarray(p["coefficients"])}
    torque = tuple(factor * size for size in config.scales.torque)  # the unit of every network's energy
    parts = [_scaled(part, p[part_name(i)], factor) for i, part in enumerate(config.parts)]
    p = {part_name(i): own for i, (_, own) in enumerate(parts)} if parts else p
    scales = replace(config.scales, torque=torque)
    return replace(config, scales=scales, parts=tuple(part for part, _ in parts)), p


def with_friction(model: JointModel, effects: Sequence[Effect]) -> tuple[JointModel, list[Effect]]:
    """Add friction at joints, of the kinds that joint models have.

    Returns:
        The model, and effects that are of no such kind, or a second friction that fades with speed at one joint.
    """
    config = model.config
    values: Values = {
        id: {name: np.exp(np.asarray(log)) for name, log in own.items()}
        for id, own in model.parameters["friction"].items()
    }
    left = [effect for effect in effects if not _add(values, effect, config.joints)]
    friction = {
        id: {name: np.log(np.maximum(value, LEAST)) for name, value in own.items()} for id, own in values.items()
    }
    changed = replace(config, friction=tuple(id for id in FRICTIONS if id in friction))
    return replace(model, config=changed, parameters={**model.parameters, "friction": friction}), left


def _add(values: Values, effect: Effect, joints: Sequence[str]) -> bool:
    """Add an effect at its joint, if that can be."""
    if effect.id not in FRICTIONS or effect.where not in joints:
        return False
    id, joint, n = effect.id, joints.index(effect.where), len(joints)
    if id == "coulomb_friction" and "stribeck_friction" in values:
        id = "stribeck_friction"  # which holds it
    if id == "stribeck_friction" and id not in values:
        sliding = values.pop("coulomb_friction", {"c": np.zeros(n)})["c"]
        values[id] = {"c": sliding, "extra": np.zeros(n), "vs": np.ones(n)}
    own = values.setdefault(id, {p.name: np.zeros(n) for p in effect.parameters()})
    if effect.id == "stribeck_friction":
        if own["extra"][joint] > 10 * LEAST:
            return False
        own["vs"][joint] = getattr(effect, "vs")  # noqa: B009
        own["extra"][joint] = getattr(effect, "extra")  # noqa: B009
        own["c"][joint] += getattr(effect, "c")  # noqa: B009
        return True
    (parameter,) = effect.parameters()
    own[parameter.name][joint] += getattr(effect, parameter.name)
    return True
