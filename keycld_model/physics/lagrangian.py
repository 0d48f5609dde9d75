"""The constrained Euler-Lagrange equations (KeyCLD paper, equation 6 and appendix A.1)."""

from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.numerics import solve_positive_definite
from keycld_model.physics.constraints import constraint_curvature, constraint_jacobian
from keycld_model.physics.masses import divided

MULTIPLIER_REGULARISATION = 1e-6
"""Relative; keeps the multipliers finite where keypoints coincide (only untrained models go there)."""


def acceleration(
    mechanism: Mechanism, masses: Array, force: Array, x: Array, v: Array, pivot: Array | None = None
) -> Array:
    """Accelerations of point masses under applied and constraint forces (paper, equation 6).

    Args:
        mechanism: the declaration.
        masses: `[K]` or `[K + L]`, positive; see `keycld_model.physics.masses`.
        force: `[n]` applied forces f = -grad V(x) + g(x) u.
        x: `[n]` positions, image units.
        v: `[n]` velocities, image units per second.
        pivot: `[2]` position of the fixed pivot; the declared one when absent.

    Returns:
        `[n]`, image units per second squared.
    """
    free = divided(mechanism, masses, force)
    if mechanism.num_constraints == 0:
        return free
    jacobian = constraint_jacobian(mechanism, x, pivot)
    schur = divided(mechanism, masses, jacobian) @ jacobian.T
    multipliers = solve_positive_definite(
        schur, jacobian @ free + constraint_curvature(mechanism, v), MULTIPLIER_REGULARISATION
    )
    return free - divided(mechanism, masses, multipliers @ jacobian)
