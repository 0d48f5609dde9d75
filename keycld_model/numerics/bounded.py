"""Small quadratic programmes within bounds."""

import jax.numpy as jnp
from jax import Array

from keycld_model.numerics.linear_algebra import solve_positive_definite


def bounded_minimum(gram: Array, demand: Array, low: Array, high: Array) -> Array:
    """The z within bounds that minimises z'Hz / 2 - d'z, by coordinate descent.

    Args:
        gram: H, `[m, m]`, symmetric positive definite.
        demand: d, `[m]`.
        low: `[m]` lower bounds; low[i] = high[i] prescribes z[i].
        high: `[m]` upper bounds.

    Returns:
        `[m]`.
    """
    size = len(demand)
    start = jnp.clip(solve_positive_definite(gram, demand), low, high)  # the solution if no bound binds
    z = [start[i] for i in range(size)]
    for _ in range(4 * size**2 if size > 1 else 0):  # ample for a handful of unknowns
        for i in range(size):
            others = sum((gram[i, j] * z[j] for j in range(size) if j != i), start=jnp.zeros_like(demand[i]))
            z[i] = jnp.clip((demand[i] - others) / gram[i, i], low[i], high[i])
    return jnp.stack(z)
