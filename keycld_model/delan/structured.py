"""Structured Deep Lagrangian Network."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Lagrangian
from keycld_model.delan.network import Parameters
from keycld_model.delan.parts import FactorNetwork, PotentialNetwork, inertia_scale
from keycld_model.numerics import solve_positive_definite


class StructuredLagrangian(Lagrangian):
    """L = v^T M(q) v / 2 - V(q) with M = L L^T (Lutter et al., ICLR 2019, equations 4 to 8); see `parts`."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__(config)
        self.factor, self.potential = FactorNetwork(config, inertia_scale(config)), PotentialNetwork(config)

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Two networks."""
        return {"factor": self.factor.initial(rng), "potential": self.potential.initial(rng)}

    def lagrangian(self, p: Parameters, q: Array, v: Array) -> Array:
        """Kinetic less potential energy, J."""
        return 0.5 * jnp.sum((v @ self.factor(p["factor"], q)) ** 2) - self.potential(p["potential"], q)

    def mass_matrix(self, p: Parameters, q: Array) -> Array:
        """L L^T, `[n, n]`."""
        lower = self.factor(p["factor"], q)
        return lower @ lower.T

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """M^-1 (tau - c - g), `[n]`."""
        bias = self.inverse_dynamics(p, q, v, jnp.zeros_like(v))
        return solve_positive_definite(self.mass_matrix(p, q), tau - bias)
