"""A network in place of the Lagrangian."""

import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.dynamics import Dynamics


class AccelerationNetwork(Dynamics):
    """A second-order neural ODE, NODE2 (KeyCLD paper, appendix A.4): x'' from position, velocity and action.

    Args:
        mechanism: the declaration; its constraints do not act.
        hidden: half the width of the three hidden layers.
        scale: factor on the output.
        kernel_scale: standard deviation of the initial weights, or None to scale them with the layer's width.
        rngs: initialisation.
    """

    def __init__(
        self, mechanism: Mechanism, hidden: int, scale: float, kernel_scale: float | None, rngs: nnx.Rngs
    ) -> None:
        super().__init__(mechanism)
        n, width, normal = 2 * mechanism.num_keypoints, 2 * hidden, nnx.initializers.normal
        init = nnx.initializers.lecun_normal() if kernel_scale is None else normal(kernel_scale)
        self.scale = scale
        self.first = nnx.Linear(2 * n + mechanism.num_actions, width, kernel_init=init, rngs=rngs)
        self.second = nnx.Linear(width, width, kernel_init=init, rngs=rngs)
        self.third = nnx.Linear(width, width, kernel_init=init, rngs=rngs)
        self.out = nnx.Linear(width, n, kernel_init=normal(kernel_scale or 0.01), rngs=rngs)

    def acceleration(self, x: Array, v: Array, u: Array) -> Array:
        """x'' `[n]` under actions u `[m]`."""
        h = jnp.concatenate([x, v, u])
        for layer in (self.first, self.second, self.third):
            h = nnx.celu(layer(h))
        return self.scale * self.out(h)
