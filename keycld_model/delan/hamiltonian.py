"""Structured Hamiltonian network."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Hamiltonian
from keycld_model.delan.network import Parameters
from keycld_model.delan.parts import FactorNetwork, PotentialNetwork, inertia_scale
from keycld_model.numerics import solve_positive_definite


class StructuredHamiltonian(Hamiltonian):
    """H = p^T W(q) p / 2 + V(q), where W = L L^T is the inverse of the mass matrix (Lutter and Peters, 2021)."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__(config)
        self.factor, self.potential = FactorNetwork(config, 1 / inertia_scale(config)), PotentialNetwork(config)

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Two networks."""
        return {"factor": self.factor.initial(rng), "potential": self.potential.initial(rng)}

    def hamiltonian(self, p: Parameters, q: Array, momentum: Array) -> Array:
        """Kinetic and potential energy, J."""
        return 0.5 * jnp.sum((momentum @ self.factor(p["factor"], q)) ** 2) + self.potential(p["potential"], q)

    def momentum(self, p: Parameters, q: Array, v: Array) -> Array:
        """W^-1 v, `[n]`."""
        return solve_positive_definite(self._inverse_mass_matrix(p, q), v)

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """W (tau - c - g), `[n]`."""
        bias = self.inverse_dynamics(p, q, v, jnp.zeros_like(v))
        return self._inverse_mass_matrix(p, q) @ (tau - bias)

    def _inverse_mass_matrix(self, p: Parameters, q: Array) -> Array:
        lower = self.factor(p["factor"], q)
        return lower @ lower.T
