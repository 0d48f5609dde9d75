"""Networks for a positive definite matrix and for a potential, which structured models share."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.network import (
    Parameters,
    encode,
    encoding_size,
    hidden_sizes,
    initial_network,
    network,
    polynomials,
    polynomials_size,
)
from keycld_model.delan.slopes import values_and_slopes

SHIFT, LEAST = 1.0, 0.01
"""A factor's diagonal is softplus(network + SHIFT) + LEAST, in units of its scale: positive, and first near one."""


class FactorNetwork:
    """Lower triangular L(q) with a positive diagonal, so that L L^T is positive definite.

    It does not hang on the first joint: that turns or shifts all that moves with it, which leaves inertias as they are.

    Args:
        config: joints and sizes.
        scale: `[n]`, usual size of the diagonal of L L^T.
    """

    def __init__(self, config: JointConfig, scale: np.ndarray) -> None:
        self.config, self.root = config, np.sqrt(scale)
        rows, columns = np.tril_indices(config.n)
        self.diagonal, self.others = rows == columns, config.after_the_first()
        self.places = np.full((config.n, config.n), len(rows))  # above the diagonal, a zero behind all entries
        self.places[rows, columns] = np.arange(len(rows))

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Weights to begin with."""
        if self.others is None:
            return {"constant": np.zeros(len(self.diagonal))}
        return initial_sum(self.others, rng, len(self.diagonal))

    def __call__(self, p: Parameters, q: Array) -> Array:
        """L(q), `[n, n]`."""
        out = p["constant"] if self.others is None else polynomials_and_network(self.others, p, q[1:])
        return self.matrix(out)

    def matrix(self, out: Array) -> Array:
        """L `[n, n]` of a network's outputs `[k]`."""
        return self._lower(jnp.where(self.diagonal, jax.nn.softplus(out + SHIFT) + LEAST, out))

    def slopes(self, out: Array, slopes: Array) -> Array:
        """Slopes of L, `[n, n, n]`, the first index that of the position, of slopes `[n, k]` of the outputs."""
        return self._lower(jnp.where(self.diagonal, jax.nn.sigmoid(out + SHIFT), 1.0) * slopes)

    def _lower(self, entries: Array) -> Array:
        """Lower triangular matrices `[..., n, n]` of their entries `[..., k]`."""
        padded = jnp.concatenate([entries, jnp.zeros_like(entries[..., :1])], axis=-1)
        return jnp.asarray(self.root)[:, None] * padded[..., self.places]


class PotentialNetwork:
    """V(q)."""

    def __init__(self, config: JointConfig) -> None:
        self.config = config
        slides = np.array([kind == "slide" for kind in config.kinds])
        arm = np.where(slides, config.scales.position, 1.0)
        self.scale = float(np.max(arm * np.array(config.scales.torque)))

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Weights to begin with."""
        return initial_sum(self.config, rng, 1)

    def __call__(self, p: Parameters, q: Array) -> Array:
        """V(q), J."""
        return self.scale * polynomials_and_network(self.config, p, q)[0]


class Energies:
    """The factor L(q) of a positive definite matrix and the potential V(q), with their slopes, in one pass.

    Args:
        config: joints and sizes.
        scale: of the factor; see `FactorNetwork`.
    """

    def __init__(self, config: JointConfig, scale: np.ndarray) -> None:
        self.factor, self.potential = FactorNetwork(config, scale), PotentialNetwork(config)

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Weights to begin with."""
        return {"factor": self.factor.initial(rng), "potential": self.potential.initial(rng)}

    def __call__(self, p: Parameters, q: Array) -> tuple[Array, Array, Array]:
        """L `[n, n]`, its slopes `[n, n, n]`, the first index that of the position, and those of V, `[n]`, J."""
        config, others = self.factor.config, self.factor.others
        sums = [] if others is None else [(others, p["factor"])]
        rows = values_and_slopes([*sums, (config, p["potential"])], q)
        entries, slopes = rows[0, :-1], rows[1:, :-1]
        if others is None:
            entries, slopes = p["factor"]["constant"], jnp.zeros((1, 1), q.dtype)
        return self.factor.matrix(entries), self.factor.slopes(entries, slopes), self.potential.scale * rows[1:, -1]


def initial_sum(config: JointConfig, rng: np.random.Generator, outputs: int) -> Parameters:
    """Weights of `polynomials_and_network`."""
    layers = initial_network(rng, [encoding_size(config), *hidden_sizes(config), outputs])
    return {"network": layers, "linear": np.zeros((polynomials_size(config), outputs))}


def polynomials_and_network(config: JointConfig, p: Parameters, q: Array) -> Array:
    """What rigid arms are nearly linear in, and a network for the rest; `[n]` to `[outputs]`."""
    return polynomials(config, q) @ p["linear"] + network(p["network"], encode(config, q))


def inertia_scale(config: JointConfig) -> np.ndarray:
    """Usual inertia of each joint, `[n]`: the largest torque scale over its acceleration's, kg m^2 or kg."""
    return np.max(config.scales.torque) / np.array(config.scales.acceleration)
