"""Black-box Lagrangian network."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.equations import Lagrangian
from keycld_model.delan.network import Parameters, encode, encoding_size, hidden_sizes, initial_network, network
from keycld_model.delan.parts import inertia_scale


class BlackBoxLagrangian(Lagrangian):
    """L(q, v) is one network of positions and velocities (Lutter and Peters, 2021, section 3.2).

    A term v^2 / 2 of the joints' usual inertias is added, so that the first step finds a motion that can be solved for.
    """

    def initial(self, rng: np.random.Generator) -> Parameters:
        """One network."""
        sizes = [encoding_size(self.config) + self.config.n, *hidden_sizes(self.config), 1]
        return {"network": initial_network(rng, sizes)}

    def lagrangian(self, p: Parameters, q: Array, v: Array) -> Array:
        """L(q, v), J."""
        scales = self.config.scales
        inertia, speed = inertia_scale(self.config), np.array(scales.velocity)
        size = float(np.max(inertia * speed**2) + np.max(scales.torque))
        x = jnp.concatenate([encode(self.config, q), v / speed])
        return size * network(p["network"], x)[0] + 0.5 * jnp.sum(inertia * v**2)

    def inertias(self, p: Parameters, q: Array, v: Array) -> Array:
        """How torques change with accelerations, `[n, n]`."""
        return jax.jacfwd(lambda a: self.inverse_dynamics(p, q, v, a))(jnp.zeros_like(v))
