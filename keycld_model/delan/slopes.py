"""Sums of polynomials and networks with their slopes by all positions, in one pass.

For one sample, products this small cost more to begin than to do. So the weights of all sums stand in one matrix, and
so do values and slopes, which go through the layers together: one product a layer, whatever is asked.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import block_diag

from keycld_model.delan.config import JointConfig
from keycld_model.delan.network import Parameters, encode, encoding_size, polynomials


def values_and_slopes(sums: Sequence[tuple[JointConfig, Parameters]], q: Array) -> Array:
    """Outputs of some `polynomials_and_network`, then their slopes by each position, `[1 + n, outputs]`.

    Args:
        sums: the joints of each, which are the last ones of all, and its weights; networks are of one depth.
        q: `[n]` positions of all joints.
    """

    def features(q: Array) -> Array:
        own = [(config, q[len(q) - config.n :]) for config, _ in sums]
        return jnp.concatenate([*[encode(*x) for x in own], *[polynomials(*x) for x in own]])

    networks = [p["network"] for _, p in sums]
    *hidden, last = [_beside([layers[name] for layers in networks]) for name in sorted(networks[0])]
    linear = block_diag(*[p["linear"] for _, p in sums])
    rows = jnp.concatenate([features(q)[None], jax.jacfwd(features)(q).T])
    inputs, is_value = sum(encoding_size(config) for config, _ in sums), np.arange(len(q) + 1)[:, None] == 0
    x = rows[:, :inputs]
    for kernel, bias in hidden:
        z = x @ kernel + jnp.where(is_value, bias, 0.0)
        value = jnp.tanh(z[0])
        x = jnp.where(is_value, value, z * (1 - value**2))
    x = jnp.concatenate([x, rows[:, inputs:]], axis=1)
    return x @ jnp.concatenate([last[0], linear]) + jnp.where(is_value, last[1], 0.0)


def _beside(layers: Sequence[Parameters]) -> tuple[Array, Array]:
    """Kernel and bias of layers of several networks, each of which sees its own inputs alone."""
    return block_diag(*[layer["kernel"] for layer in layers]), jnp.concatenate([layer["bias"] for layer in layers])
