"""Small networks of joint positions, as functions of nested dictionaries of weights."""

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig

Parameters = dict[str, Any]
ONE_PLANE = 4
"""Joints from which on polynomials are those of one plane: of three hinges there are 26, of four 80."""
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


def polynomials(config: JointConfig, q: Array) -> Array:
    """What energies of rigid arms are linear in: `[n]` to `[k]`, without the constant.

    Products over the joints of one, cosine and sine (hinges) or scaled position (slides), 3^n - 1 of n hinges. From
    `ONE_PLANE` joints on, those of an arm in one plane are taken: cosines and sines of sums of angles of joints that
    follow each other.
    """
    hinges = [kind == "hinge" for kind in config.kinds]
    places = (q - np.array(config.scales.centre)) / np.array(config.scales.position)
    if config.n >= ONE_PLANE:
        angles = jnp.where(np.array(hinges), q, 0.0)
        sums = jnp.stack([angles[i:j].sum() for i in range(config.n) for j in range(i + 1, config.n + 1)])
        return jnp.concatenate([jnp.cos(sums), jnp.sin(sums), places[~np.array(hinges)]])
    one = jnp.ones((), q.dtype)
    own = [[jnp.cos(x), jnp.sin(x)] if hinge else [place] for hinge, x, place in zip(hinges, q, places, strict=True)]
    return all_products([jnp.stack([one, *factors]) for factors in own])[1:]


def all_products(factors: Sequence[Array]) -> Array:
    """Products of one factor of each of some vectors, the last one's changing fastest, `[k]`."""
    return reduce(lambda whole, own: jnp.outer(whole, own).ravel(), factors)


def polynomials_size(config: JointConfig) -> int:
    """Length of `polynomials`."""
    return jax.eval_shape(lambda q: polynomials(config, q), np.zeros(config.n)).shape[0]


def hidden_sizes(config: JointConfig) -> list[int]:
    """Of the hidden layers."""
    return [config.width] * config.depth
