"""The white-box baseline: base parameters of an arm by linear least squares.

The energies of any chain of rigid bodies are linear in its inertial parameters (Atkeson, An and Hollerbach, 1986), and
polynomials in the cosines and sines of hinges and the positions of slides: of degree two in each joint for inertias, of
degree one for weight. Inertias do not depend on the first joint. So torques are linear in the coefficients of these
polynomials, whatever the arm's lengths and axes, and no model of it is needed. Their number grows as five to the power
of the joints; from `LARGEST` joints on, they are those of arms whose links move in one plane: sums of angles.
"""

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
RANK = 1e-10
"""Singular values below this share of the largest belong to combinations that the recordings do not move."""
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


def fit_least_squares(config: JointConfig, q: Floats, v: Floats, a: Floats, tau: Floats, weights: Floats) -> Parameters:
    """Coefficients of least norm that explain torques best.

    Args:
        config: of the family "least_squares".
        q: `[N, n]` positions.
        v: `[N, n]` velocities.
        a: `[N, n]` accelerations.
        tau: `[N, n]` torques.
        weights: `[N, n]`, one over the standard deviation of each torque's error.

    Returns:
        Parameters of the family.

    Raises:
        InputError: if there are fewer torques than coefficients.
    """
    family = LeastSquares(config)
    rows = np.asarray(jax.jit(jax.vmap(family.regressor))(q, v, a)) * weights[..., None]
    matrix, target = rows.reshape(-1, rows.shape[-1]), (tau * weights).ravel()
    if len(matrix) < matrix.shape[1]:
        raise InputError(
            f"{len(matrix)} torques cannot tell the {matrix.shape[1]} coefficients of the least-squares baseline; "
            "record more."
        )
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0] = 1.0
    solution = np.linalg.lstsq(matrix / size, target, rcond=RANK)[0] / size
    number = rows.shape[-1] - config.n * len(config.friction)
    friction = initial_friction(config)
    for i, (id, name) in enumerate(linear_parameters(config)):
        values = solution[number + i * config.n : number + (i + 1) * config.n]
        friction[id] = {key: np.full(config.n, np.log(LEAST)) for key in friction[id]}
        friction[id][name] = np.log(np.maximum(values, LEAST))
    return {"equations": {"coefficients": solution[:number]}, "friction": friction}
