"""The state at the first frame, from keypoints or pixels of several frames."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from keycld_model.dynamics import Dynamics

DAMPING = 1e-6
KEYPOINT_WEIGHT = 20.0
"""Weight of a keypoint's deviation (image units) beside a pixel's (0 to 1) in `refine_state`."""


def estimate_state(
    dynamics: Dynamics,
    keypoints: Array,
    actions: Array,
    timestep: float,
    iterations: int = 5,
    start: tuple[Array, Array] | None = None,
    fine: bool = False,
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
        start: position and velocity `[n]` to begin from; the first two frames give them when absent.
        fine: divide steps in which a rod turns far, see `Dynamics.rollout`.

    Returns:
        Position and velocity `[n]` at the first frame; both meet the constraints.
    """
    guess = (keypoints[0], (keypoints[1] - keypoints[0]) / timestep) if start is None else start

    def residual(x: Array, v: Array) -> Array:
        return (dynamics.rollout(x, v, actions, timestep, fine)[0] - keypoints).ravel()

    state = dynamics.project(*guess)
    state, _ = jax.lax.scan(
        lambda s, _: (_gauss_newton(dynamics, residual, s, timestep), None), state, length=iterations
    )
    return state


def refine_state(
    dynamics: Dynamics,
    render: Callable[[Array], Array],
    frames: Array,
    keypoints: Array,
    actions: Array,
    timestep: float,
    start: tuple[Array, Array],
    iterations: int = 3,
) -> tuple[Array, Array]:
    """Least-squares fit of a trajectory of the model to pixels and keypoints together (analysis by synthesis).

    Errors of the keypoint estimator and of the renderer are independent, and each is about a tenth of a pixel; together
    they determine the state better than either. A step that does not improve the fit is not taken.

    Args:
        dynamics: the model.
        render: draws frames `[C, H, W, 3]` of positions `[C, n]`.
        frames: `[C, H, W, 3]` the first C frames, 0 to 1.
        keypoints: `[C, n]` measured at these frames.
        actions: `[C-1, m]` held between them.
        timestep: seconds between frames.
        start: position and velocity `[n]` at the first frame to begin from.
        iterations: Gauss-Newton steps.

    Returns:
        Position and velocity `[n]` at the first frame; both meet the constraints.
    """

    def residual(x: Array, v: Array) -> Array:
        positions, _ = dynamics.rollout(x, v, actions, timestep, fine=True)
        pixels = (render(positions) - frames).ravel()
        return jnp.concatenate([pixels, KEYPOINT_WEIGHT * (positions - keypoints).ravel()])

    def improve(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        new = _gauss_newton(dynamics, residual, state, timestep)
        better = jnp.sum(residual(*new) ** 2) < jnp.sum(residual(*state) ** 2)
        return (jnp.where(better, new[0], state[0]), jnp.where(better, new[1], state[1])), None

    state, _ = jax.lax.scan(improve, start, length=iterations)
    return state


def _gauss_newton(
    dynamics: Dynamics, residual: Callable[[Array, Array], Array], state: tuple[Array, Array], timestep: float
) -> tuple[Array, Array]:
    """One step in the coordinates of the tangent space."""
    x, v = state
    basis = dynamics.tangent_space(x)
    dof = basis.shape[1]

    def moved(z: Array) -> tuple[Array, Array]:
        return dynamics.project(x + basis @ z[:dof], v + basis @ z[dof:] / timestep)

    zero = jnp.zeros(2 * dof, x.dtype)
    error, jacobian = residual(x, v), jax.jacfwd(lambda z: residual(*moved(z)))(zero)
    normal = jacobian.T @ jacobian
    normal = normal + DAMPING * jnp.trace(normal) * jnp.eye(2 * dof, dtype=x.dtype)
    return moved(-jnp.linalg.solve(normal, jacobian.T @ error))
