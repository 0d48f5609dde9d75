"""Pictures of rigid parts: each in coordinates that move with it, all laid over what stands still."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.nets.hourglass import grid
from keycld_model.nets.segments import squared_distance

SCALE = 0.12
"""Image units (4 of 64 pixels) by which coordinates of a part are divided before they enter its network."""
FREQUENCY = (1.2, 2.4)
"""Standard deviation of the first layer's weights, along and across a part: radians per `SCALE`."""
SOFT = 0.015
"""Image units over which a part fades beyond its reach; at twice that, a fiftieth is left."""
COVERED = 4
"""Parts cover a quarter of an image at most; what is further from them is not looked at."""


def sine(x: Array) -> Array:
    """Within .0011 of a sine, with a continuous slope; XLA's takes several times as long on a CPU."""
    turn = x / (2 * jnp.pi)
    turn = turn - jnp.round(turn)
    parabola = 8 * turn * (1 - 2 * jnp.abs(turn))
    return parabola * (0.775 + 0.225 * jnp.abs(parabola))


class Part(NamedTuple):
    """What is rigid.

    Attributes:
        start: keypoint at which its coordinates begin; None is the fixed pivot.
        end: keypoint towards which they point; None if they do not turn.
    """

    start: int | None
    end: int | None


def rigid_parts(mechanism: Mechanism) -> tuple[Part, ...]:
    """One for every rod, and one that does not turn for every keypoint at which no rod ends."""
    held = {rod.end for rod in mechanism.rods}
    loose = [Part(k, None) for k in range(mechanism.num_keypoints) if k not in held]
    return (*loose, *(Part(rod.start, rod.end) for rod in mechanism.rods))


class RigidParts(nnx.Module):
    """Draws a frame: colour and opacity of each part are a network of the place on it (Sitzmann et al. 2020, SIREN).

    A picture that turns with a rod is the same in every pose, which a convolution over maps of the pose must learn for
    each. So a keypoint has to be where the parts that meet in it are joined: elsewhere, one of them would be blurred.

    Args:
        parts: what is rigid.
        image_shape: (H, W).
        hidden: widths of the two hidden layers.
        rngs: initialisation.
    """

    def __init__(
        self, parts: tuple[Part, ...], image_shape: tuple[int, int], hidden: tuple[int, int], rngs: nnx.Rngs
    ) -> None:
        self.parts, self.image_shape = parts, image_shape
        n, (first, second) = len(parts), hidden
        normal = nnx.initializers.normal(1.0)
        spread = jnp.asarray(FREQUENCY)[:, None]
        self.background = nnx.Param(jnp.zeros((*image_shape, 3)))
        self.reach = nnx.Param(jnp.asarray(SCALE))
        self.first = nnx.Param(spread * normal(rngs.params(), (n, 2, first)))
        self.phase = nnx.Param(jax.random.uniform(rngs.params(), (n, first), maxval=2 * jnp.pi))
        self.second = nnx.Param(normal(rngs.params(), (n, first, second)) * (2.0 / first) ** 0.5)
        self.shift = nnx.Param(jnp.zeros((n, second)))
        self.out = nnx.Param(0.1 * normal(rngs.params(), (n, second, 4)))
        self.level = nnx.Param(jnp.zeros((n, 4)).at[:, 3].set(-2.0))
        self.front = nnx.Param(jnp.zeros(n))

    def __call__(self, keypoints: Array, pivot: Array) -> Array:
        """Images `[B, H, W, 3]`, about 0 to 1.

        Args:
            keypoints: `[B, K, 2]`, image units.
            pivot: `[2]`, image units.
        """
        pixels, background = grid(*self.image_shape, 1).reshape(-1, 2), self.background[...].reshape(-1, 3)
        count = len(pixels) // COVERED

        def draw(x: Array) -> Array:
            near = jax.lax.top_k(-jax.lax.stop_gradient(self.distance(x, pivot, pixels)), count)[1]
            return background.at[near].set(self.at(x, pivot, pixels[near], background[near]))

        return jax.vmap(draw)(keypoints).reshape(-1, *self.image_shape, 3)

    def at(self, keypoints: Array, pivot: Array, pixels: Array, background: Array) -> Array:
        """Colours `[M, 3]` at some pixels.

        Args:
            keypoints: `[K, 2]`, image units.
            pivot: `[2]`, image units.
            pixels: `[M, 2]`, image units.
            background: `[M, 3]` what stands still there.
        """
        opacities, colours = [], []
        for i in range(len(self.parts)):
            along, across, length = self._place(i, keypoints, pivot, pixels)
            beyond = jnp.maximum(jnp.maximum(-along, along - length), jnp.abs(across))
            fades = jnp.exp(-((jnp.maximum(0.0, beyond - self._reach) / SOFT) ** 2))
            hidden = sine(jnp.stack([along, across], -1) / SCALE @ self.first[i] + self.phase[i])
            hidden = sine(hidden @ self.second[i] + self.shift[i])
            out = nnx.sigmoid(hidden @ self.out[i] + self.level[i])
            opacities.append(fades * out[:, 3])
            colours.append(out[:, :3])
        opacity = jnp.stack(opacities)
        weight = opacity * jnp.exp(self.front[...] - jnp.max(self.front[...]))[:, None]
        weight = weight / (jnp.sum(weight, 0) + 1e-6)
        through = jnp.prod(1.0 - opacity, axis=0)[:, None]
        return through * background + (1.0 - through) * jnp.einsum("pm,pmc->mc", weight, jnp.stack(colours))

    def distance(self, keypoints: Array, pivot: Array, pixels: Array) -> Array:
        """`[M]` from pixels `[M, 2]` to the nearest rod or loose keypoint, image units."""
        squared = []
        for start, end in self.parts:
            origin = pivot if start is None else keypoints[start]
            squared.append(squared_distance(pixels, origin, origin if end is None else keypoints[end]))
        return jnp.sqrt(jnp.min(jnp.stack(squared), axis=0))

    @property
    def _reach(self) -> Array:
        return jax.lax.stop_gradient(self.reach[...])

    def _place(self, i: int, keypoints: Array, pivot: Array, pixels: Array) -> tuple[Array, Array, Array]:
        """Along and across part i, `[M]` each, and its length."""
        start, end = self.parts[i]
        origin = pivot if start is None else keypoints[start]
        offset = pixels - origin
        if end is None:
            return offset[:, 0], offset[:, 1], jnp.zeros(())
        rod = keypoints[end] - origin
        length = jnp.sqrt(jnp.sum(rod**2) + 1e-12)
        along = rod / length
        return offset @ along, offset @ jnp.stack([-along[1], along[0]]), length
