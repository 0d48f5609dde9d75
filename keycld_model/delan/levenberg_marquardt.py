"""Levenberg-Marquardt steps for networks of some thousand weights (Marquardt, 1963; Hagan and Menhaj, 1994).

Errors are nearly linear in the weights near a good fit, so that a step solves what thousands of gradient steps approach.
A step costs the product of the Jacobian with itself, and one Cholesky factorisation.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dsyrk

Floats = NDArray[np.float64]
CHUNK = 512
"""Samples whose Jacobian is in memory at once."""
FACTOR = 4.0
"""By which the damping changes from step to step."""
START, LEAST, MOST = 1e-4, 1e-13, 1e6
"""Damping at the start, and its bounds, all per residual."""


@dataclass(frozen=True)
class Point:
    """Where a fit is.

    Attributes:
        w: `[P]` weights.
        damping: added to the diagonal of the normal equations, per residual.
        cost: mean square of the weighted errors; infinite before the first step.
        stuck: no damping gives a step downwards.
    """

    w: Floats
    damping: float = START
    cost: float = np.inf
    stuck: bool = False


class LeastSquaresProblem:
    """Sum of squares of errors of samples.

    Args:
        errors: maps weights `[P]` and one sample, a tuple of arrays, to its weighted errors `[k]`.
        samples: arrays of one length.
    """

    def __init__(self, errors: Callable[..., Array], samples: tuple[Floats, ...]) -> None:
        number = len(samples[0])
        padded = -number % CHUNK
        arrays = [np.concatenate([s, np.repeat(s[-1:], padded, axis=0)]) for s in samples]
        counts = np.concatenate([np.ones(number), np.zeros(padded)])
        with jax.enable_x64(True):
            pieces = [tuple(map(jnp.asarray, a)) for a in zip(*(np.split(x, len(counts) // CHUNK) for x in arrays))]
            self._chunks = list(zip(np.split(counts, len(counts) // CHUNK), pieces, strict=True))

        def chunk_errors(w: Array, count: Array, chunk: tuple[Array, ...]) -> Array:
            return jax.vmap(lambda *sample: errors(w, *sample))(*chunk) * count[:, None]

        def linearised(w: Array, count: Array, chunk: tuple[Array, ...]) -> tuple[Array, Array]:
            def one(n: Array, *sample: Array) -> tuple[Array, Array]:
                value, back = jax.vjp(lambda w: n * errors(w, *sample), w)
                return value, jax.vmap(lambda e: back(e)[0])(jnp.eye(len(value), dtype=value.dtype))

            value, jacobian = jax.vmap(one)(count, *chunk)
            return value.ravel(), jacobian.reshape(-1, len(w))

        self._errors, self._linearised, self._number = jax.jit(chunk_errors), jax.jit(linearised), number

    def cost(self, w: Floats) -> float:
        """Mean over samples and errors of their squares."""
        with jax.enable_x64(True):
            values = [np.asarray(self._errors(w, *chunk)) for chunk in self._chunks]
        return float(sum(np.sum(v**2) for v in values) / (self._number * values[0].shape[1]))

    def normal_equations(self, w: Floats) -> tuple[Floats, Floats, int]:
        """J^T J `[P, P]`, its lower triangle, J^T e `[P]`, and the number of errors."""
        matrix, vector, rows = np.zeros((len(w), len(w)), order="F"), np.zeros(len(w)), 0
        for chunk in self._chunks:
            with jax.enable_x64(True):
                errors, jacobian = map(np.asarray, self._linearised(w, *chunk))
            matrix = dsyrk(1.0, jacobian.T, beta=1.0, c=matrix, lower=1, overwrite_c=1)
            vector += jacobian.T @ errors
            rows += len(errors)
        return matrix, vector, rows


def step(problem: LeastSquaresProblem, point: Point) -> Point:
    """The best step that some damping gives, if any goes downwards."""
    matrix, vector, rows = problem.normal_equations(point.w)
    cost = point.cost if np.isfinite(point.cost) else problem.cost(point.w)
    damping, diagonal = point.damping, matrix.diagonal().copy()
    while damping <= MOST:
        np.fill_diagonal(matrix, diagonal + damping * rows)
        try:
            move = cho_solve(cho_factor(matrix, lower=True), vector)
            found = problem.cost(point.w - move)
        except np.linalg.LinAlgError:
            found = np.inf
        if found < cost:
            return Point(point.w - move, max(damping / FACTOR, LEAST), found)
        damping *= FACTOR
    return replace(point, cost=cost, stuck=True)
