"""How a learned model may be off by itself: as another arm, or another shape of the weight, would differ from it.

A learned model is known from the motions that it has learned from, and to within their noise. What it is off by is
mostly a smooth difference of energies, which no friction is. It is written as a Lagrangian that is linear in
coefficients: base parameters of an arm (see `least_squares`), and further harmonics of the weight at each joint.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Lagrangian
from keycld_model.delan.least_squares import LeastSquares
from keycld_model.delan.network import Parameters
from keycld_model.delan.parts import PotentialNetwork, inertia_scale

WHOLE = 2
"""Joints up to which inertias may be off in all their dependence on positions; of more, they are by constants."""
HARMONICS = (2, 3)
"""Of the weight, per turn of each hinge, beside the first."""


class Deviation(Lagrangian):
    """A difference of energies; coefficients are shares of the model's usual inertias and torques."""

    def __init__(self, config: JointConfig) -> None:
        super().__init__(config)
        self.arm, self.potential = LeastSquares(config), PotentialNetwork(config)
        self.slides = np.array([kind == "slide" for kind in config.kinds])
        root, pairs = np.sqrt(inertia_scale(config)), self.arm.pairs
        self.inertia = root[pairs[:, 0]] * root[pairs[:, 1]]

    @property
    def number(self) -> int:
        """Of coefficients."""
        return jax.eval_shape(self.terms, *[np.zeros(self.config.n)] * 2).shape[0]

    def initial(self, rng: np.random.Generator) -> Parameters:
        """None at all."""
        return {"coefficients": np.zeros(self.number)}

    def lagrangian(self, p: Parameters, q: Array, v: Array) -> Array:
        """L, J."""
        return self.terms(q, v) @ p["coefficients"]

    def terms(self, q: Array, v: Array) -> Array:
        """What the coefficients multiply, `[k]`, J."""
        config, pairs, slides = self.config, self.arm.pairs, self.slides
        reach = jnp.where(slides, (q - np.array(config.scales.centre)) / np.array(config.scales.position), q)
        inertias, weights = self.arm.polynomials(reach)
        if config.n > WHOLE:
            inertias = jnp.ones((1,), q.dtype)
        products = 0.5 * self.inertia * v[pairs[:, 0]] * v[pairs[:, 1]]
        turns, shifts = reach[~slides], reach[slides]
        waves = [f(k * turns) for k in HARMONICS for f in (jnp.cos, jnp.sin)]
        more = jnp.concatenate([*waves, *[shifts**k for k in HARMONICS]])
        return jnp.concatenate(
            [jnp.outer(products, inertias).ravel(), -self.potential.scale * jnp.concatenate([weights, more])]
        )
