"""90 % intervals of what a world model has learned of a mechanism."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_model.modules import Parameters, Parts
from keycld_model.places import to_masses
from keycld_model.uncertainty import NORMAL_90, Uncertainty, with_numbers

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Intervals:
    """90 % intervals, the low and the high end on the last axis.

    Attributes:
        masses: [K, 2] fractions of the total; then [L, 2] in the middle of rods between two joints.
        lengths: [R, 2] of the rods between masses and from the pivot, image units.
        potential_energy: [N, 2] V at each given position, less V at the first, image units squared per second squared,
            per total mass; None if no positions were given.
        input_matrix: [N, 2K, m, 2] forces g along the directions in which the masses can move, image units per second
            squared, per total mass and per unit of action; None if no positions were given. What acts along rods is
            borne by them and shows in no motion.
    """

    masses: Floats
    lengths: Floats
    potential_energy: Floats | None = None
    input_matrix: Floats | None = None


def intervals(parts: Parts, parameters: Parameters, uncertainty: Uncertainty, at: Floats | None) -> Intervals:
    """Of first order: the middle, and 1.645 standard deviations to either side, as far as masses and lengths go.

    Args:
        parts: the networks.
        parameters: of the model.
        uncertainty: of its numbers.
        at: `[N, K, 2]` keypoints as the model sees them, image units.
    """
    mechanism = parts.config.mechanism
    rods = len(mechanism.rods)

    def member(numbers: dict[str, Array], x: Array) -> dict[str, Array]:
        lagrangian = parts.lagrangian(with_numbers(parameters, numbers))
        masses, level = lagrangian.masses, numbers["level"][:rods]
        x = to_masses(mechanism, numbers, x)
        energy = jax.vmap(lagrangian.potential_energy)(x)
        basis = jax.vmap(lagrangian.tangent_space)(x)
        force = basis @ (jnp.swapaxes(basis, -1, -2) @ jax.vmap(lagrangian.input_matrix)(x))
        lengths = jnp.sqrt(2 * jnp.maximum(level, 0))
        return {"masses": masses, "lengths": lengths, "potential_energy": energy - energy[0], "input_matrix": force}

    n = 2 * mechanism.num_keypoints
    x = jnp.zeros((1, n)) if at is None else jnp.asarray(at.reshape(-1, n))
    members = jax.jit(jax.vmap(member, (0, None)))(uncertainty.either_side(), x)
    found = {name: _interval(np.asarray(values, np.float64)) for name, values in members.items()}
    if at is None:
        found = {name: found[name] for name in ("masses", "lengths")}
    found["masses"], found["lengths"] = found["masses"].clip(0, 1), found["lengths"].clip(0)
    return Intervals(**found)


def _interval(values: NDArray[np.float64]) -> Floats:
    """`[..., 2]` of values in the middle, and a standard deviation to either side each, `[1 + 2r, ...]`."""
    more, less = np.split(values[1:], 2)
    half = NORMAL_90 * np.sqrt((((more - less) / 2) ** 2).sum(axis=0))
    return np.stack([values[0] - half, values[0] + half], axis=-1).astype(np.float32)
