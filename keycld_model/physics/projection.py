"""Projection of positions and velocities on a mechanism's constraints, in the metric of the mass matrix."""

from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.numerics import solve_positive_definite
from keycld_model.physics.constraints import constraint, constraint_jacobian
from keycld_model.physics.lagrangian import MULTIPLIER_REGULARISATION
from keycld_model.physics.masses import divided


def project_position(
    mechanism: Mechanism, masses: Array, level: Array, x: Array, pivot: Array | None = None, iterations: int = 2
) -> Array:
    """Move positions on to the manifold Phi(x) = level by Newton steps.

    Args:
        mechanism: the declaration.
        masses: `[K]` or `[K + L]`; see `keycld_model.physics.masses`.
        level: `[c]` values of Phi to meet.
        x: `[n]` positions close to the manifold.
        pivot: `[2]` position of the fixed pivot; the declared one when absent.
        iterations: Newton steps; convergence is quadratic.

    Returns:
        `[n]`.
    """
    if mechanism.num_constraints == 0:
        return x
    for _ in range(iterations):
        jacobian = constraint_jacobian(mechanism, x, pivot)
        error = constraint(mechanism, x, pivot) - level
        multipliers = solve_positive_definite(
            divided(mechanism, masses, jacobian) @ jacobian.T, error, MULTIPLIER_REGULARISATION
        )
        x = x - divided(mechanism, masses, multipliers @ jacobian)
    return x


def project_velocity(mechanism: Mechanism, masses: Array, x: Array, v: Array, pivot: Array | None = None) -> Array:
    """Remove from velocities `[n]` the part that would violate D Phi(x) v = 0; arguments as above."""
    if mechanism.num_constraints == 0:
        return v
    jacobian = constraint_jacobian(mechanism, x, pivot)
    multipliers = solve_positive_definite(
        divided(mechanism, masses, jacobian) @ jacobian.T, jacobian @ v, MULTIPLIER_REGULARISATION
    )
    return v - divided(mechanism, masses, multipliers @ jacobian)
