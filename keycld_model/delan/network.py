"""Small networks of joint positions, as functions of nested dictionaries of weights."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig

Parameters = dict[str, Any]
LAST = 0.1
"""Factor on the initial weights of the last layer, so that models begin near zero."""


def initial_network(rng: np.random.Generator, sizes: Sequence[int]) -> Parameters:
    """Weights of a multilayer perceptron: normal, of variance one over a layer's inputs (LeCun); no biases.

    Args:
        rng: source of the weights.
        sizes: of the input, each hidden layer, and the output.
    """
    layers: Parameters = {}
    for i, (inputs, outputs) in enumerate(pairwise(sizes)):
        factor = LAST if i == len(sizes) - 2 else 1.0
        kernel = factor * rng.standard_normal((inputs, outputs)) / np.sqrt(inputs)
        layers[f"layer_{i}"] = {"kernel": kernel, "bias": np.zeros(outputs)}
    return layers


def network(layers: Parameters, x: Array) -> Array:
    """Multilayer perceptron with tanh, whose derivatives of any order are smooth; `[inputs]` to `[outputs]`."""
    *hidden, last = (layers[name] for name in sorted(layers))
    for layer in hidden:
        x = jnp.tanh(x @ layer["kernel"] + layer["bias"])
    return x @ last["kernel"] + last["bias"]


def encoding_size(config: JointConfig) -> int:
    """Length of `encode`."""
    return sum(2 if kind == "hinge" else 1 for kind in config.kinds)


def encode(config: JointConfig, q: Array) -> Array:
    """Positions as networks see them: cosine and sine of hinges, slides scaled; `[n]` to `[encoding_size]`."""
    hinges = np.array([kind == "hinge" for kind in config.kinds])
    slides = (q - np.array(config.scales.centre)) / np.array(config.scales.position)
    return jnp.concatenate([jnp.cos(q[hinges]), jnp.sin(q[hinges]), slides[~hinges]])


def hidden_sizes(config: JointConfig) -> list[int]:
    """Of the hidden layers."""
    return [config.width] * config.depth
