"""Equations of motion that a scalar function of the state implies, and what every family of models can do.

All functions are of one sample; `jax.vmap` makes batches of them. Torques are without friction; see `friction`.
"""

from abc import ABC, abstractmethod

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.network import Parameters


class Equations(ABC):
    """One family of models of the motion of n joints.

    Attributes:
        config: joints and sizes of networks.
        conserves: the family has energies; without friction, only torques change them.
    """

    conserves: bool = True

    def __init__(self, config: JointConfig) -> None:
        self.config = config

    @abstractmethod
    def initial(self, rng: np.random.Generator) -> Parameters:
        """Parameters to begin training with."""

    @abstractmethod
    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n]` that accelerate by a `[n]` in the state q `[n]`, v `[n]`."""

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """Accelerations `[n]` under torques `[n]`; what `inverse_dynamics` says is linear in accelerations."""
        rest = jnp.zeros_like(v)
        matrix = jax.jacfwd(lambda a: self.inverse_dynamics(p, q, v, a))(rest)
        return jnp.linalg.solve(matrix, tau - self.inverse_dynamics(p, q, v, rest))

    def mass_matrix(self, p: Parameters, q: Array) -> Array:
        """Inertias `[n, n]` at rest: how torques change with accelerations."""
        rest = jnp.zeros_like(q)
        return jax.jacfwd(lambda a: self.inverse_dynamics(p, q, rest, a))(rest)

    def inertias(self, p: Parameters, q: Array, v: Array) -> Array:
        """Inertias `[n, n]` in motion; those at rest where kinetic energy is quadratic in velocities."""
        return self.mass_matrix(p, q)

    def potential_energy(self, p: Parameters, q: Array) -> Array:
        """Energy at rest, J, up to a constant."""
        raise NotImplementedError

    def energy(self, p: Parameters, q: Array, v: Array) -> Array:
        """Kinetic and potential energy, J, up to a constant."""
        raise NotImplementedError

    def prediction_errors(self, p: Parameters, q: Array, v: Array, a: Array, tau: Array, friction: Array) -> Array:
        """What training makes small: errors of the torques `[n]`, N m or N.

        Where no mechanics tie accelerations to torques, their errors `[n]` follow, in the same scale.
        """
        errors = self.inverse_dynamics(p, q, v, a) + friction - tau
        if self.conserves:
            return errors
        scale = np.array(self.config.scales.torque) / np.array(self.config.scales.acceleration)
        return jnp.concatenate([errors, (self.forward_dynamics(p, q, v, tau - friction) - a) * scale])


class Lagrangian(Equations):
    """Motion by the Euler-Lagrange equation d/dt dL/dv - dL/dq = tau (Lutter et al., ICLR 2019, equation 2)."""

    @abstractmethod
    def lagrangian(self, p: Parameters, q: Array, v: Array) -> Array:
        """L(q, v), J."""

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n]`; the time derivative of the momenta dL/dv is one along (v, a)."""
        _, rate = jax.jvp(lambda q, v: jax.grad(self.lagrangian, 2)(p, q, v), (q, v), (v, a))
        return rate - jax.grad(self.lagrangian, 1)(p, q, v)

    def potential_energy(self, p: Parameters, q: Array) -> Array:
        """-L(q, 0), J, up to a constant."""
        return -self.lagrangian(p, q, jnp.zeros_like(q))

    def energy(self, p: Parameters, q: Array, v: Array) -> Array:
        """dL/dv v - L, J."""
        value, rate = jax.jvp(lambda v: self.lagrangian(p, q, v), (v,), (v,))
        return rate - value


class Hamiltonian(Equations):
    """Motion by Hamilton's equations v = dH/dp, dp/dt = tau - dH/dq (Greydanus et al., 2019).

    Robots measure velocities, not momenta: they follow from each other by the Legendre transform.
    """

    @abstractmethod
    def hamiltonian(self, p: Parameters, q: Array, momentum: Array) -> Array:
        """H(q, momentum), J."""

    @abstractmethod
    def momentum(self, p: Parameters, q: Array, v: Array) -> Array:
        """Momenta `[n]` that belong to velocities: the inverse of v = dH/dp."""

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n]`."""
        momentum, rate = jax.jvp(lambda q, v: self.momentum(p, q, v), (q, v), (v, a))
        return rate + jax.grad(self.hamiltonian, 1)(p, q, momentum)

    def potential_energy(self, p: Parameters, q: Array) -> Array:
        """H without momentum, J, up to a constant."""
        return self.hamiltonian(p, q, jnp.zeros_like(q))

    def energy(self, p: Parameters, q: Array, v: Array) -> Array:
        """H, J."""
        return self.hamiltonian(p, q, self.momentum(p, q, v))
