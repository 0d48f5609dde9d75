"""Networks for a positive definite matrix and for a potential, which structured models share."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.network import Parameters, encode, encoding_size, hidden_sizes, initial_network, network

SHIFT, LEAST = 1.0, 0.01
"""A factor's diagonal is softplus(network + SHIFT) + LEAST, in units of its scale: positive, and first near one."""


class FactorNetwork:
    """Lower triangular L(q) with a positive diagonal, so that L L^T is positive definite.

    Args:
        config: joints and sizes.
        scale: `[n]`, usual size of the diagonal of L L^T.
    """

    def __init__(self, config: JointConfig, scale: np.ndarray) -> None:
        self.config, self.root = config, np.sqrt(scale)
        self.rows, self.columns = np.tril_indices(config.n)

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Weights to begin with."""
        return initial_network(rng, [encoding_size(self.config), *hidden_sizes(self.config), len(self.rows)])

    def __call__(self, layers: Parameters, q: Array) -> Array:
        """L(q), `[n, n]`."""
        out = network(layers, encode(self.config, q))
        out = jnp.where(self.rows == self.columns, jax.nn.softplus(out + SHIFT) + LEAST, out)
        lower = jnp.zeros((self.config.n, self.config.n), out.dtype).at[self.rows, self.columns].set(out)
        return jnp.asarray(self.root)[:, None] * lower


class PotentialNetwork:
    """V(q): a network, and a term linear in the positions of slides, along which weight does not return."""

    def __init__(self, config: JointConfig) -> None:
        self.config = config
        self.slides = np.array([kind == "slide" for kind in config.kinds])
        arm = np.where(self.slides, config.scales.position, 1.0)
        self.scale = float(np.max(arm * np.array(config.scales.torque)))

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Weights to begin with."""
        layers = initial_network(rng, [encoding_size(self.config), *hidden_sizes(self.config), 1])
        return {"network": layers, "linear": np.zeros(int(self.slides.sum()))}

    def __call__(self, p: Parameters, q: Array) -> Array:
        """V(q), J."""
        x = encode(self.config, q)
        slides = x[x.shape[0] - int(self.slides.sum()) :]
        return self.scale * (network(p["network"], x)[0] + slides @ p["linear"])


def inertia_scale(config: JointConfig) -> np.ndarray:
    """Usual inertia of each joint, `[n]`: the largest torque scale over its acceleration's, kg m^2 or kg."""
    return np.max(config.scales.torque) / np.array(config.scales.acceleration)
