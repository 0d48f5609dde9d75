"""The white-box baseline: base parameters of an arm by linear least squares.

The energies of any chain of rigid bodies are linear in its inertial parameters (Atkeson, An and Hollerbach, 1986), and
polynomials in the cosines and sines of hinges and the positions of slides: of degree two in each joint for inertias, of
degree one for weight. Inertias do not depend on the first joint. So torques are linear in the coefficients of these
polynomials, whatever the arm's lengths and axes, and no model of it is needed. Their number grows as five to the power
of the joints; from `LARGEST` joints on, they are those of arms whose links move in one plane: sums of angles.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Lagrangian
from keycld_model.delan.friction import initial_friction, linear_columns, linear_parameters
from keycld_model.delan.network import ONE_PLANE, Parameters, all_products
from keycld_model.numerics import solve_positive_definite

Floats = NDArray[np.float64]
CUTOFFS = (1e-10, *(10.0 ** (k / 2) for k in range(-12, 0)))
"""Shares of the largest singular value, below which combinations of coefficients stay zero: the least one where only
those are left out that recordings do not move at all, more where others are known too badly (Hansen, 1987)."""
TINY = 1e-300
"""Beside errors, whose logarithm is taken, and singular values, by which is divided: none is zero."""
LEAST = 1e-12
"""N m and so on: friction cannot be negative, and its logarithm is stored."""


class LeastSquares(Lagrangian):
    """L = sum of coefficients times products of velocities and polynomials of positions; see above."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__(config)
        self.pairs = np.array(list(combinations_with_replacement(range(config.n), 2)))

    def initial(self, rng: np.random.Generator) -> Parameters:
        """No coefficient yet."""
        return {"coefficients": np.zeros(jax.eval_shape(self.terms, *[np.zeros(self.config.n)] * 2).shape[0])}

    def lagrangian(self, p: Parameters, q: Array, v: Array) -> Array:
        """L, J."""
        return self.terms(q, v) @ p["coefficients"]

    def terms(self, q: Array, v: Array) -> Array:
        """What the coefficients multiply, `[k]`."""
        inertias, weights = self.polynomials(q)
        products = v[self.pairs[:, 0]] * v[self.pairs[:, 1]]
        return jnp.concatenate([jnp.outer(products, inertias).ravel(), -weights])

    def polynomials(self, q: Array) -> tuple[Array, Array]:
        """For inertias and for weight, each `[k]`."""
        return self._in_one_plane(q) if self.config.n >= ONE_PLANE else self._products(q)

    def _products(self, q: Array) -> tuple[Array, Array]:
        """Of any arm."""
        one, firsts, seconds = jnp.ones((), q.dtype), [], []
        for x, kind in zip(q, self.config.kinds, strict=True):
            firsts.append([one, jnp.cos(x), jnp.sin(x)] if kind == "hinge" else [one, x])
            seconds.append([jnp.cos(2 * x), jnp.sin(2 * x)] if kind == "hinge" else [x**2])
        whole = [jnp.stack([*first, *second]) for first, second in zip(firsts, seconds, strict=True)]
        return all_products([one[None], *whole[1:]]), all_products([jnp.stack(first) for first in firsts])[1:]

    def _in_one_plane(self, q: Array) -> tuple[Array, Array]:
        """The same of arms in one plane: cosines and sines of sums of angles of joints that follow each other."""
        hinges = np.array([kind == "hinge" for kind in self.config.kinds])
        angles = jnp.where(hinges, q, 0.0)
        sums = [angles[i:j].sum() for i in range(1, len(q)) for j in range(i + 1, len(q) + 1)]
        whole = [angles[:j].sum() for j in range(1, len(q) + 1)]
        waves = [f(x) for x in sums for f in (jnp.cos, jnp.sin)]
        falls = [f(x) for x in whole for f in (jnp.cos, jnp.sin)]
        slides = [q[j] for j in range(len(q)) if not hinges[j]]
        return jnp.stack([jnp.ones((), q.dtype), *waves, *slides]), jnp.stack([*falls, *slides])

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """Accelerations `[n]`."""
        bias = self.inverse_dynamics(p, q, v, jnp.zeros_like(v))
        return solve_positive_definite(self.mass_matrix(p, q), tau - bias)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n, k]` per unit of each coefficient, then of each friction parameter."""
        momenta = jax.jacfwd(self.terms, 1)  # [k, n]
        _, rate = jax.jvp(lambda q, v: momenta(q, v), (q, v), (v, a))
        return jnp.concatenate([(rate - jax.jacfwd(self.terms, 0)(q, v)).T, linear_columns(self.config, v)], axis=1)


def regressors(config: JointConfig, q: Floats, v: Floats, a: Floats) -> Floats:
    """Torques `[N, n, k]` per unit of each coefficient and friction parameter, for q, v and a, `[N, n]` each."""
    return np.asarray(jax.jit(jax.vmap(LeastSquares(config).regressor))(q, v, a))


def fit_least_squares(
    config: JointConfig, rows: Floats, tau: Floats, weights: Floats, cutoff: float = CUTOFFS[0]
) -> Parameters:
    """Coefficients of least norm that explain torques best.

    Args:
        config: of the family "least_squares".
        rows: `[N, n, k]`, see `regressors`.
        tau: `[N, n]` torques.
        weights: `[N, n]`, one over the standard deviation of each torque's error.
        cutoff: of `CUTOFFS`.

    Returns:
        Parameters of the family.

    Raises:
        InputError: if there are fewer torques than coefficients.
    """
    matrix, target = (rows * weights[..., None]).reshape(-1, rows.shape[-1]), (tau * weights).ravel()
    if len(matrix) < matrix.shape[1]:
        raise InputError(
            f"{len(matrix)} torques cannot tell the {matrix.shape[1]} coefficients of the least-squares baseline; "
            "record more."
        )
    (solution,) = _solutions(matrix, target, (cutoff,))
    number = matrix.shape[1] - config.n * len(config.friction)
    friction = initial_friction(config)
    for i, (id, name) in enumerate(linear_parameters(config)):
        values = solution[number + i * config.n : number + (i + 1) * config.n]
        friction[id] = {key: np.full(config.n, np.log(LEAST)) for key in friction[id]}
        friction[id][name] = np.log(np.maximum(values, LEAST))
    return {"equations": {"coefficients": solution[:number]}, "friction": friction}


def chosen_cutoff(rows: Floats, tau: Floats, weight: Floats, folds: NDArray[np.int_]) -> float:
    """The lowest cutoff that predicts torques of which it has not learned as well as the best one does.

    By cross-validation with the rule of one standard error (Breiman et al., 1984), of logarithms of errors: those of
    cutoffs that are too low differ by powers of ten.

    Args:
        rows: `[N, n, k]`, see `regressors`.
        tau: `[N, n]` torques.
        weight: `[n]`, one over the usual error of a joint's torque.
        folds: `[N]`, number of the fold that each sample is of; each is held out once.
    """
    rows, tau, errors = rows * weight[:, None], tau * weight, []
    for fold in np.unique(folds):
        held, number = folds == fold, rows.shape[-1]
        solutions = _solutions(rows[~held].reshape(-1, number), tau[~held].ravel(), CUTOFFS)
        errors.append([np.log(np.mean((rows[held] @ solution - tau[held]) ** 2) + TINY) for solution in solutions])
    found = np.array(errors)
    worse = found - found[:, [np.argmin(found.mean(axis=0))]]
    good = worse.mean(axis=0) <= worse.std(axis=0, ddof=1) / np.sqrt(len(worse))
    return CUTOFFS[int(np.argmax(good))]


def _solutions(matrix: Floats, target: Floats, cutoffs: Sequence[float]) -> list[Floats]:
    """Coefficients by a truncated singular value decomposition of columns of equal size, for each cutoff."""
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0] = 1.0
    left, values, right = np.linalg.svd(matrix / size, full_matrices=False)
    parts = (left.T @ target)[:, None] * right / np.maximum(values, TINY)[:, None]
    return [parts[values > cutoff * values[0]].sum(axis=0) / size for cutoff in cutoffs]
