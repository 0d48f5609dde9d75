"""Closed-form solves of very small systems."""

import jax
import jax.numpy as jnp
from jax import Array


def solve_positive_definite(a: Array, b: Array, regularisation: float = 0.0) -> Array:
    """Solve a z = b for symmetric positive definite a by an unrolled Cholesky factorisation.

    XLA fuses the scalar operations; for the 1 to 4 unknowns of a mechanism's multipliers this is tens of times
    faster on a CPU than `jnp.linalg.pinv`, forward and backward.

    Args:
        a: `[n, n]`, symmetric positive definite.
        b: `[n]` or `[n, k]`.
        regularisation: added to the diagonal as a fraction of its mean, so that a singular `a` gives a finite
            answer and a finite gradient.

    Returns:
        z: as b.
    """
    n = a.shape[0]
    if n == 0:
        return b
    shift = regularisation * jnp.trace(a) / n if regularisation else 0.0
    lower: list[list[Array]] = [[] for _ in range(n)]
    for i in range(n):
        for j in range(i):
            inner = sum((lower[i][k] * lower[j][k] for k in range(j)), start=jnp.zeros_like(a[0, 0]))
            lower[i].append((a[i, j] - inner) / lower[j][j])
        inner = sum((entry * entry for entry in lower[i]), start=jnp.zeros_like(a[0, 0]))
        lower[i].append(jnp.sqrt(jnp.maximum(a[i, i] + shift - inner, jnp.finfo(a.dtype).tiny)))
    y: list[Array] = []
    for i in range(n):
        inner = sum((lower[i][k] * y[k] for k in range(i)), start=jnp.zeros_like(b[0]))
        y.append((b[i] - inner) / lower[i][i])
    z: list[Array] = [b[0]] * n
    for i in reversed(range(n)):
        inner = sum((lower[k][i] * z[k] for k in range(i + 1, n)), start=jnp.zeros_like(b[0]))
        z[i] = (y[i] - inner) / lower[i][i]
    return jnp.stack(z)


def null_space(a: Array) -> Array:
    """Orthonormal basis of the null space of a full-rank wide matrix.

    Args:
        a: `[c, n]` with c < n and full row rank.

    Returns:
        `[n, n - c]`, columns orthonormal and orthogonal to the rows of `a`. A fixed function of `a`, but its columns
        may be rotated among themselves from one `a` to the next.
    """
    q, _ = jax.lax.linalg.qr(a.T, full_matrices=True)
    return q[:, a.shape[0] :]
