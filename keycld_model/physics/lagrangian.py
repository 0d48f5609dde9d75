"""The constrained Euler-Lagrange equations (KeyCLD paper, equation 6 and appendix A.1)."""

import jax.numpy as jnp
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.numerics import solve_positive_definite
from keycld_model.physics.constraints import constraint_curvature, constraint_jacobian

MULTIPLIER_REGULARISATION = 1e-6
"""Relative; keeps the multipliers finite where keypoints coincide (only untrained models go there)."""


def mass_matrix(masses: Array) -> Array:
    """M, `[2K, 2K]` diagonal, from point masses `[K]` (paper, equation 14)."""
    return jnp.diag(jnp.repeat(masses, 2))


def kinetic_energy(masses: Array, v: Array) -> Array:
    """T = v' M v / 2 (scalar) of velocities `[2K]` and masses `[K]`."""
    return 0.5 * jnp.sum(jnp.repeat(masses, 2) * v**2)


def acceleration(
    mechanism: Mechanism, masses: Array, force: Array, x: Array, v: Array, pivot: Array | None = None
) -> Array:
    """Accelerations of point masses under applied and constraint forces (paper, equation 6).

    Args:
        mechanism: the declaration.
        masses: `[K]`, positive.
        force: `[n]` applied forces f = -grad V(x) + g(x) u.
        x: `[n]` positions, image units.
        v: `[n]` velocities, image units per second.
        pivot: `[2]` position of the fixed pivot; the declared one when absent.

    Returns:
        `[n]`, image units per second squared.
    """
    inverse_mass = 1.0 / jnp.repeat(masses, 2)
    free = inverse_mass * force
    if mechanism.num_constraints == 0:
        return free
    jacobian = constraint_jacobian(mechanism, x, pivot)
    schur = (jacobian * inverse_mass[None]) @ jacobian.T
    multipliers = solve_positive_definite(
        schur, jacobian @ free + constraint_curvature(mechanism, v), MULTIPLIER_REGULARISATION
    )
    return free - inverse_mass * (multipliers @ jacobian)
