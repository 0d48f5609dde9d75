"""The classical fourth-order Runge-Kutta method."""

from collections.abc import Callable

from jax import Array


def rk4_step(
    acceleration: Callable[[Array, Array], Array], x: Array, v: Array, step_size: float | Array
) -> tuple[Array, Array]:
    """One step of a second-order system x'' = acceleration(x, x').

    Args:
        acceleration: maps positions `[n]` and velocities `[n]` to accelerations `[n]`.
        x: `[n]` positions.
        v: `[n]` velocities.
        step_size: seconds.

    Returns:
        Positions and velocities `[n]` one step later; the error of one step is of order step_size**5.
    """
    h = step_size
    a1 = acceleration(x, v)
    v2 = v + 0.5 * h * a1
    a2 = acceleration(x + 0.5 * h * v, v2)
    v3 = v + 0.5 * h * a2
    a3 = acceleration(x + 0.5 * h * v2, v3)
    v4 = v + h * a3
    a4 = acceleration(x + h * v3, v4)
    return x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
