"""The mass matrix of point masses: one at every keypoint and, where those cannot be a link, one in its middle.

In the plane a rigid link has a mass, a centre along its rod and a moment of inertia. Two masses at its ends have two
numbers. A rod from the pivot only turns, and the mass at the end of a link that carries nothing may be elsewhere along
it (`keycld_model.places`); a rod between two joints needs a third number, which is a mass in its middle. That moves by
the mean of the ends' velocities and so couples them: a consistent mass matrix in place of a diagonal one (Archer,
Consistent Mass Matrix for Distributed Mass Systems, 1963).

Masses are `[K]` of the keypoints, or `[K + L]` with those of the L rods of `places.inner_rods` in their order.
"""

from collections.abc import Sized

import jax.numpy as jnp
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.numerics import solve_positive_definite
from keycld_model.places import inner_rods


def heavy_rods(mechanism: Mechanism, masses: Sized) -> list[tuple[int, int]]:
    """Rods (start, end) that have masses of their own: all between two joints, or none."""
    return inner_rods(mechanism) if len(masses) > mechanism.num_keypoints else []


def mass_matrix(mechanism: Mechanism, masses: Array) -> Array:
    """M, `[2K, 2K]`; diagonal (paper, equation 14) where no rod has a mass of its own."""
    return jnp.kron(_by_keypoint(mechanism, masses), jnp.eye(2, dtype=masses.dtype))


def lumped(mechanism: Mechanism, masses: Array) -> Array:
    """Masses `[K]` of the keypoints, with half of each rod's at either end: sums of the mass matrix's rows."""
    return _by_keypoint(mechanism, masses).sum(axis=1) if heavy_rods(mechanism, masses) else masses


def momentum(mechanism: Mechanism, masses: Array, v: Array) -> Array:
    """M v `[n]` of velocities `[n]`."""
    if not heavy_rods(mechanism, masses):
        return jnp.repeat(masses, 2) * v
    return (_by_keypoint(mechanism, masses) @ v.reshape(-1, 2)).reshape(-1)


def divided(mechanism: Mechanism, masses: Array, forces: Array) -> Array:
    """M⁻¹ f `[..., n]` of forces `[..., n]`: accelerations of masses that nothing holds."""
    if not heavy_rods(mechanism, masses):
        return jnp.broadcast_to(1.0 / jnp.repeat(masses, 2), forces.shape) * forces
    count = mechanism.num_keypoints
    by_keypoint = jnp.moveaxis(forces.reshape(-1, count, 2), 1, 0)
    free = solve_positive_definite(_by_keypoint(mechanism, masses), by_keypoint.reshape(count, -1))
    return jnp.moveaxis(free.reshape(by_keypoint.shape), 0, 1).reshape(forces.shape)


def kinetic_energy(mechanism: Mechanism, masses: Array, v: Array) -> Array:
    """T = v' M v / 2 (scalar) of velocities `[n]`."""
    return 0.5 * jnp.sum(momentum(mechanism, masses, v) * v)


def _by_keypoint(mechanism: Mechanism, masses: Array) -> Array:
    """`[K, K]`, the same in x and z."""
    count = mechanism.num_keypoints
    out = jnp.diag(masses[:count])
    for (start, end), mass in zip(heavy_rods(mechanism, masses), masses[count:], strict=True):
        ends = jnp.zeros(count, masses.dtype).at[jnp.array([start, end])].set(0.5)
        out = out + mass * jnp.outer(ends, ends)
    return out
