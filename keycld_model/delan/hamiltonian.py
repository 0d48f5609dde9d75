"""Structured Hamiltonian network."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Hamiltonian
from keycld_model.delan.network import Parameters
from keycld_model.delan.parts import Energies, inertia_scale
from keycld_model.numerics import solve_positive_definite


class StructuredHamiltonian(Hamiltonian):
    """H = p^T W(q) p / 2 + V(q), where W = L L^T is the inverse of the mass matrix (Lutter and Peters, 2021)."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__(config)
        self.energies = Energies(config, 1 / inertia_scale(config))
        self.factor, self.potential = self.energies.factor, self.energies.potential

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Two networks."""
        return self.energies.initial(rng)

    def hamiltonian(self, p: Parameters, q: Array, momentum: Array) -> Array:
        """Kinetic and potential energy, J."""
        return 0.5 * jnp.sum((momentum @ self.factor(p["factor"], q)) ** 2) + self.potential(p["potential"], q)

    def momentum(self, p: Parameters, q: Array, v: Array) -> Array:
        """W^-1 v, `[n]`."""
        return solve_positive_definite(self._inverse_mass_matrix(p, q), v)

    def prediction_errors(self, p: Parameters, q: Array, v: Array, a: Array, tau: Array, friction: Array) -> Array:
        """Errors of the torques `[n]`, by the general equation, whose slopes by all weights cost less."""
        return super().inverse_dynamics(p, q, v, a) + friction - tau

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """W (tau - c - g), `[n]`."""
        lower, slopes, gravity = self.energies(p, q)
        momentum = solve_positive_definite(lower @ lower.T, v)
        change, force = _changes(lower, slopes, gravity, momentum, v)
        return change + lower @ ((tau - force) @ lower)

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """W^-1 (a - dW/dt p) + dH/dq, `[n]`."""
        lower, slopes, gravity = self.energies(p, q)
        momentum = solve_positive_definite(lower @ lower.T, v)
        change, force = _changes(lower, slopes, gravity, momentum, v)
        return solve_positive_definite(lower @ lower.T, a - change) + force

    def _inverse_mass_matrix(self, p: Parameters, q: Array) -> Array:
        lower = self.factor(p["factor"], q)
        return lower @ lower.T


def _changes(lower: Array, slopes: Array, gravity: Array, momentum: Array, v: Array) -> tuple[Array, Array]:
    """dW/dt p `[n]`, the acceleration of a constant momentum, and dH/dq `[n]`."""
    w, w_slopes = momentum @ lower, momentum @ slopes  # L^T p `[n]`, and its slopes by each position `[n, n]`
    return lower @ (v @ w_slopes) + jnp.tensordot(v, slopes, 1) @ w, w_slopes @ w + gravity
