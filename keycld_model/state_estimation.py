"""The state at the first frame, from keypoints of several frames."""

import jax
import jax.numpy as jnp
from jax import Array

from keycld_model.dynamics import Dynamics
from keycld_model.numerics import null_space
from keycld_model.physics import constraint_jacobian

DAMPING = 1e-6


def estimate_state(
    dynamics: Dynamics, keypoints: Array, actions: Array, timestep: float, iterations: int = 5
) -> tuple[Array, Array]:
    """Least-squares fit of a trajectory of the model to measured keypoints (Gauss-Newton on the manifold).

    All frames count, and the known actions and the learned forces act between them, so that a fast mechanism needs no
    finite differences: a velocity error of one frame pair averages out and curvature does not bias it.

    Args:
        dynamics: the model.
        keypoints: `[C, n]` measured at the first C frames, C >= 2.
        actions: `[C-1, m]` held between them.
        timestep: seconds between frames.
        iterations: Gauss-Newton steps.

    Returns:
        Position and velocity `[n]` at the first frame; both meet the constraints.
    """
    mechanism = dynamics.mechanism
    x, v = dynamics.project(keypoints[0], (keypoints[1] - keypoints[0]) / timestep)

    def improve(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        x, v = state
        basis = null_space(constraint_jacobian(mechanism, x, dynamics.pivot[...]))
        dof = basis.shape[1]

        def moved(z: Array) -> tuple[Array, Array]:
            return dynamics.project(x + basis @ z[:dof], v + basis @ z[dof:] / timestep)

        def residual(z: Array) -> Array:
            positions, _ = dynamics.rollout(*moved(z), actions, timestep)
            return (positions - keypoints).ravel()

        zero = jnp.zeros(2 * dof, x.dtype)
        error, jacobian = residual(zero), jax.jacfwd(residual)(zero)
        normal = jacobian.T @ jacobian
        normal = normal + DAMPING * jnp.trace(normal) * jnp.eye(2 * dof, dtype=x.dtype)
        return moved(-jnp.linalg.solve(normal, jacobian.T @ error)), None

    (x, v), _ = jax.lax.scan(improve, (x, v), None, length=iterations)
    return x, v
