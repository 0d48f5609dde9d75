"""Friction at every joint, by the equations of the effects in `keycld_envs.effects`."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_envs.effects import EFFECTS, Effect, functions
from keycld_model.delan.config import JointConfig
from keycld_model.delan.network import Parameters

START = 0.02
"""Friction that training begins with, as a share of a joint's usual torque at its usual speed."""
FADING = 0.2
"""Share of the usual speed at which Stribeck friction begins with having faded; a search of the diagnosis tries .08
and .3."""


def _sign(v: Any) -> Array:
    """The effects' sign of velocities, continuous through zero."""
    return functions.smooth_sign(v)  # type: ignore[return-value]  # JAX's for arrays of JAX


def initial_friction(config: JointConfig) -> Parameters:
    """Logarithms of the effects' parameters, `[n]` each: they are positive."""
    torque, speed = START * np.array(config.scales.torque), np.array(config.scales.velocity)
    start = {
        "viscous_friction": {"b": torque / speed},
        "coulomb_friction": {"c": torque},
        "stribeck_friction": {"c": torque, "extra": torque, "vs": FADING * speed},
        "quadratic_drag": {"d": torque / speed**2},
    }
    return {id: {name: np.log(value) for name, value in start[id].items()} for id in config.friction}


def friction_torque(p: Parameters, v: Array) -> Array:
    """Torque that motors need against friction, `[n]`, for velocities `[n]`: the effects' forces with another sign."""
    total = jnp.zeros_like(v)
    for id, logarithms in p.items():
        value = {name: jnp.exp(log) for name, log in logarithms.items()}
        total = total + FORMULAS[id](value, v)
    return total


def _viscous(value: dict[str, Array], v: Array) -> Array:
    return value["b"] * v


def _coulomb(value: dict[str, Array], v: Array) -> Array:
    return value["c"] * _sign(v)


def _stribeck(value: dict[str, Array], v: Array) -> Array:
    return (value["c"] + value["extra"] * jnp.exp(-((v / value["vs"]) ** 2))) * _sign(v)


def _quadratic(value: dict[str, Array], v: Array) -> Array:
    return value["d"] * v * jnp.abs(v)


FORMULAS = {
    "viscous_friction": _viscous,
    "coulomb_friction": _coulomb,
    "stribeck_friction": _stribeck,
    "quadratic_drag": _quadratic,
}
"""By the id of the effect; tests compare each with the effect's own force in MuJoCo."""


def effects(config: JointConfig, p: Parameters) -> tuple[Effect, ...]:
    """The learned friction as effects at joints, for simulators, environments and the diagnosis."""
    return tuple(
        EFFECTS[id](joint).with_parameters(**{name: float(np.exp(log[j])) for name, log in p[id].items()})
        for id in config.friction
        for j, joint in enumerate(config.joints)
    )


def linear_parameters(config: JointConfig) -> list[tuple[str, str]]:
    """Effect and parameter of each group of n columns of `linear_columns`."""
    return [(id, {"viscous_friction": "b", "quadratic_drag": "d"}.get(id, "c")) for id in config.friction]


def linear_columns(config: JointConfig, v: Array) -> Array:
    """Torques `[n, k n]` per unit of the k parameters in which friction is linear, one joint after another.

    Stribeck friction counts as Coulomb friction, its limit at higher speed.
    """
    one = {"b": v, "c": _sign(v), "d": v * jnp.abs(v)}
    columns = [jnp.diag(one[name]) for _, name in linear_parameters(config)]
    return jnp.concatenate([*columns, jnp.zeros((config.n, 0), v.dtype)], axis=1)
