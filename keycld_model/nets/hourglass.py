"""The hourglass both image networks share (KeyCLD paper, appendix A.4)."""

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array


class Block(nnx.Module):
    """Convolution 3x3, group normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, groups: int, rngs: nnx.Rngs) -> None:
        self.conv = nnx.Conv(inputs, outputs, (3, 3), kernel_init=nnx.initializers.he_normal(), rngs=rngs)
        self.norm = nnx.GroupNorm(outputs, num_groups=groups, rngs=rngs)

    def __call__(self, x: Array) -> Array:
        """Features `[B, H, W, inputs]` to `[B, H, W, outputs]`."""
        return nnx.relu(self.norm(self.conv(x)))


class Hourglass(nnx.Module):
    """Two levels of down- and upsampling with skip connections.

    Args:
        inputs: channels in.
        outputs: channels out.
        width: channels at the finest level; they double at each level down.
        groups: groups of every normalisation.
        rngs: initialisation.
        output_scale: scale of the initial weights of the last layer.
    """

    def __init__(
        self, inputs: int, outputs: int, width: int, groups: int, rngs: nnx.Rngs, output_scale: float = 1.0
    ) -> None:
        self.fine = Block(inputs, width, groups, rngs)
        self.middle = Block(width, 2 * width, groups, rngs)
        self.coarse = Block(2 * width, 4 * width, groups, rngs)
        self.middle_up = Block(6 * width, 2 * width, groups, rngs)
        self.fine_up = Block(3 * width, width, groups, rngs)
        init = nnx.initializers.variance_scaling(output_scale**2, "fan_in", "normal")
        self.out = nnx.Conv(width, outputs, (3, 3), kernel_init=init, rngs=rngs)

    def __call__(self, x: Array) -> Array:
        """Features `[B, H, W, inputs]` to `[B, H, W, outputs]`; H and W are multiples of 4."""
        fine = self.fine(x)
        middle = self.middle(halve(fine))
        coarse = self.coarse(halve(middle))
        middle = self.middle_up(jnp.concatenate([double(coarse), middle], axis=-1))
        fine = self.fine_up(jnp.concatenate([double(middle), fine], axis=-1))
        return self.out(fine)


def halve(x: Array) -> Array:
    """Max-pool 2x2 by pairwise maxima, whose gradient is many times faster on a CPU than a window reduction's."""
    b, h, w, c = x.shape
    x = x.reshape(b, h // 2, 2, w // 2, 2, c)
    rows = jnp.maximum(x[:, :, 0], x[:, :, 1])
    return jnp.maximum(rows[:, :, :, 0], rows[:, :, :, 1])


def double(x: Array) -> Array:
    """Nearest-neighbour upsampling 2x2."""
    b, h, w, c = x.shape
    return jnp.broadcast_to(x[:, :, None, :, None], (b, h, 2, w, 2, c)).reshape(b, 2 * h, 2 * w, c)


def fold(x: Array, factor: int) -> Array:
    """Space to depth: `[B, H, W, C]` to `[B, H/f, W/f, f*f*C]`."""
    if factor == 1:
        return x
    b, h, w, c = x.shape
    x = x.reshape(b, h // factor, factor, w // factor, factor, c)
    return x.transpose(0, 1, 3, 2, 4, 5).reshape(b, h // factor, w // factor, factor * factor * c)


def unfold(x: Array, factor: int) -> Array:
    """Depth to space, the inverse of `fold`."""
    if factor == 1:
        return x
    b, h, w, c = x.shape
    x = x.reshape(b, h, w, factor, factor, c // factor**2)
    return x.transpose(0, 1, 3, 2, 4, 5).reshape(b, h * factor, w * factor, c // factor**2)


def grid(height: int, width: int, factor: int) -> Array:
    """Centres of the cells of a folded image in image units, `[H/f, W/f, 2]`.

    Pixel centres span -1 to 1 in each direction, x to the right, y up.
    """

    def axis(size: int) -> Array:
        return (jnp.arange(0, size, factor) + 0.5 * (factor - 1)) / (size - 1) * 2 - 1

    x, y = jnp.meshgrid(axis(width), -axis(height))
    return jax.lax.stop_gradient(jnp.stack([x, y], axis=-1))
