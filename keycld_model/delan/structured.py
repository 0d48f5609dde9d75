"""Structured Deep Lagrangian Network."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Lagrangian
from keycld_model.delan.network import Parameters
from keycld_model.delan.parts import Energies, inertia_scale
from keycld_model.numerics import solve_positive_definite


class StructuredLagrangian(Lagrangian):
    """L = v^T M(q) v / 2 - V(q) with M = L L^T (Lutter et al., ICLR 2019, equations 4 to 8); see `parts`."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__(config)
        self.energies = Energies(config, inertia_scale(config))
        self.factor, self.potential = self.energies.factor, self.energies.potential

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Two networks."""
        return self.energies.initial(rng)

    def lagrangian(self, p: Parameters, q: Array, v: Array) -> Array:
        """Kinetic less potential energy, J."""
        return 0.5 * jnp.sum((v @ self.factor(p["factor"], q)) ** 2) - self.potential(p["potential"], q)

    def mass_matrix(self, p: Parameters, q: Array) -> Array:
        """L L^T, `[n, n]`."""
        lower = self.factor(p["factor"], q)
        return lower @ lower.T

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """M a + c + g, `[n]`."""
        lower, slopes, gravity = self.energies(p, q)
        return lower @ (a @ lower) + _coriolis(lower, slopes, v) + gravity

    def prediction_errors(self, p: Parameters, q: Array, v: Array, a: Array, tau: Array, friction: Array) -> Array:
        """Errors of the torques `[n]`, by the general equation, whose slopes by all weights cost less."""
        return super().inverse_dynamics(p, q, v, a) + friction - tau

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """M^-1 (tau - c - g), `[n]`."""
        lower, slopes, gravity = self.energies(p, q)
        return solve_positive_definite(lower @ lower.T, tau - _coriolis(lower, slopes, v) - gravity)


def _coriolis(lower: Array, slopes: Array, v: Array) -> Array:
    """dM/dt v - d(v^T M v / 2)/dq, `[n]`."""
    w, w_slopes = v @ lower, v @ slopes  # L^T v `[n]`, and its slopes by each position `[n, n]`
    return lower @ (v @ w_slopes) + jnp.tensordot(v, slopes, 1) @ w - w_slopes @ w
