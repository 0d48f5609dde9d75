"""Levenberg-Marquardt steps for networks of a few thousand weights (Hagan and Menhaj, 1994).

Errors are nearly linear in the weights near a good fit, so that a step solves what thousands of gradient steps only
approach. A step costs the product of the Jacobian with itself, and a Cholesky factorisation or two.

Weights are normal a priori. How strongly that holds them is what makes the measured torques most likely (MacKay, 1992;
Foresee and Hagan, 1997): as good as not at all without noise, and just so that noise is not learned with it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, get_blas_funcs, get_lapack_funcs

from keycld_model.training.sharding import Devices

Floats = NDArray[np.float64]
(dsyrk,) = get_blas_funcs(("syrk",), dtype=np.float64)
dpotrf, dpotri = get_lapack_funcs(("potrf", "potri"), dtype=np.float64)
CHUNK = 512
"""Samples whose Jacobian is in memory at once."""
FACTOR = 4.0
"""By which the damping changes from step to step."""
START, LEAST, MOST = 1e-4, 1e-13, 1e6
"""Damping at the start, and its bounds, all per residual."""

FEWEST = 1e-3
"""Weights of a group that errors determine at least: none at all would end it for good."""
TIGHTEST = 1e12
"""Most that errors may count for beside weights a priori, as a ratio of variances."""
MOST_DETERMINED = 0.9
"""Share of the independent errors that weights can use up at most, so that some are left to tell the noise."""


@dataclass(frozen=True)
class Point:
    """Where a fit is.

    Attributes:
        w: `[P]` weights.
        damping: added to the diagonal of the normal equations, per residual.
        prior: variance of the errors over that of the weights a priori, of each group.
        cost: mean square of the weighted errors; infinite before the first step.
        stuck: no damping gives a step downwards.
    """

    w: Floats
    damping: float = START
    prior: tuple[float, ...] = ()
    cost: float = np.inf
    stuck: bool = False


class LeastSquaresProblem:
    """Sum of squares of errors of samples, which are divided over all devices that JAX has.

    Args:
        errors: maps weights `[P]` and one sample, a tuple of arrays, to its weighted errors `[k]`.
        samples: arrays of one length.
        groups: `[P]`, from 0 on: weights of one group are normal a priori, of one variance; those of -1 are free.
        repeats: samples that say the same, because errors of neighbours are alike.
    """

    def __init__(
        self, errors: Callable[..., Array], samples: tuple[Floats, ...], groups: NDArray[np.int_], repeats: float = 1.0
    ) -> None:
        self.groups, self.repeats = groups, repeats
        number = len(samples[0])
        padded = -number % CHUNK
        arrays = [np.concatenate([s, np.repeat(s[-1:], padded, axis=0)]) for s in samples]
        counts = np.concatenate([np.ones(number), np.zeros(padded)])
        devices, parts = Devices(), len(counts) // CHUNK
        with jax.enable_x64(True):
            pieces = zip(*(np.split(x, parts) for x in (counts, *arrays)), strict=True)
            self._chunks = [devices.divide(tuple(map(jnp.asarray, piece))) for piece in pieces]

        def chunk_errors(w: Array, count: Array, *chunk: Array) -> Array:
            return jax.vmap(lambda *sample: errors(w, *sample))(*chunk) * count[:, None]

        def linearised(w: Array, count: Array, *chunk: Array) -> tuple[Array, Array]:
            def one(n: Array, *sample: Array) -> tuple[Array, Array]:
                value, back = jax.vjp(lambda w: n * errors(w, *sample), w)
                return value, jax.vmap(lambda e: back(e)[0])(jnp.eye(len(value), dtype=value.dtype))

            value, jacobian = jax.vmap(one)(count, *chunk)
            return value.ravel(), jacobian.reshape(-1, len(w))

        jit = partial(jax.jit, **({} if devices.everywhere is None else {"out_shardings": devices.everywhere}))
        self._errors, self._linearised, self._number = jit(chunk_errors), jit(linearised), number

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
    """The best step that some damping gives, if any goes downwards, with the prior that is most likely before it."""
    matrix, vector, rows = problem.normal_equations(point.w)
    cost = point.cost if np.isfinite(point.cost) else problem.cost(point.w)
    diagonal = matrix.diagonal().copy()
    prior = _likely_prior(matrix, point, problem, cost * rows, rows)
    held = np.append(prior, 0.0)[problem.groups]
    vector = vector + held * point.w
    goal, damping = cost * rows + np.sum(held * point.w**2), point.damping
    while damping <= MOST:
        np.fill_diagonal(matrix, diagonal + held + damping * rows)
        try:
            w = point.w - cho_solve(cho_factor(matrix, lower=True), vector)
            found = problem.cost(w)
        except np.linalg.LinAlgError:
            found, w = np.inf, point.w
        if found * rows + np.sum(held * w**2) < goal:
            return Point(w, max(damping / FACTOR, LEAST), prior, found)
        damping *= FACTOR
    return replace(point, cost=cost, stuck=True)


def _likely_prior(
    matrix: Floats, point: Point, problem: LeastSquaresProblem, squares: float, rows: int
) -> tuple[float, ...]:
    """Update of the priors by the number of weights that the errors determine (MacKay, 1992, equation 4.8)."""
    groups, independent = problem.groups, rows / problem.repeats
    members = [np.flatnonzero(groups == g) for g in range(int(groups.max(initial=-1)) + 1)]
    prior = np.array(point.prior or (0.0,) * len(members))
    if not np.isfinite(point.cost) or not members:
        return tuple(prior.tolist())
    held = np.append(prior, 0.0)[groups]
    whole = matrix.copy(order="F")
    whole[np.diag_indices_from(whole)] += held + LEAST * rows
    factor, failed = dpotrf(whole, lower=1, overwrite_a=1)
    inverse, failed = dpotri(factor, lower=1, overwrite_c=1) if not failed else (factor, failed)
    if failed:
        return tuple(prior.tolist())
    free = 1 - held * inverse.diagonal()
    determined = np.array([max(float(free[own].sum()), FEWEST) for own in members])
    determined *= min(1.0, MOST_DETERMINED * independent / determined.sum())
    weights = np.array([np.sum(point.w[own] ** 2) for own in members])
    with np.errstate(divide="ignore"):
        found = determined * squares / ((independent - determined.sum()) * weights)
    return tuple(np.where(weights > 0, np.minimum(found, TIGHTEST), prior).tolist())
