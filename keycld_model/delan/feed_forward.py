"""Feed-forward networks in place of mechanics."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.equations import Equations
from keycld_model.delan.network import Parameters, encode, encoding_size, hidden_sizes, initial_network, network


class FeedForward(Equations):
    """One network for the torques, another for the accelerations; nothing ties them together."""

    conserves = False

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Two networks."""
        n = self.config.n
        sizes = [encoding_size(self.config) + 2 * n, *hidden_sizes(self.config), n]
        return {"inverse": initial_network(rng, sizes), "forward": initial_network(rng, sizes)}

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n]`."""
        scales = self.config.scales
        x = jnp.concatenate([encode(self.config, q), v / np.array(scales.velocity), a / np.array(scales.acceleration)])
        return jnp.array(scales.torque) * network(p["inverse"], x)

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """Accelerations `[n]`."""
        scales = self.config.scales
        x = jnp.concatenate([encode(self.config, q), v / np.array(scales.velocity), tau / np.array(scales.torque)])
        return jnp.array(scales.acceleration) * network(p["forward"], x)
