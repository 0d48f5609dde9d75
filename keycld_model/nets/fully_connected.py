"""Images to keypoints and back through fully connected layers: the ablation FC (KeyCLD paper, appendix A.4).

Coordinates come out of a layer that sees the whole image, and images out of one that sees all coordinates, so that
neither knows where in the image a keypoint is.
"""

from itertools import pairwise

import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_model.nets.estimator import contrast
from keycld_model.nets.hourglass import Block, double, fold, halve, unfold

LEVELS = (1, 2, 4, 8)
"""Channels of the four levels, in widths."""
NEURONS = 256
"""Width of the fully connected layer."""


class FullyConnectedEstimator(nnx.Module):
    """Four levels of convolutions, each halved, then two fully connected layers.

    Args:
        num_keypoints: K.
        image_shape: (H, W).
        width: channels at the finest level.
        groups: groups of the normalisations.
        folding: 1 works at full resolution as in the paper; 2 folds 2x2 pixels into channels first.
        difference: see differences to the mean frame; otherwise raw images, as in the paper.
        rngs: initialisation.
    """

    def __init__(
        self,
        num_keypoints: int,
        image_shape: tuple[int, int],
        width: int,
        groups: int,
        folding: int,
        difference: bool,
        rngs: nnx.Rngs,
    ) -> None:
        self.folding = folding
        self.background = nnx.Param(jnp.full((*image_shape, 3), 0.5)) if difference else None
        channels = [3 * folding**2, *(level * width for level in LEVELS)]
        self.first, self.second, self.third, self.fourth = (Block(a, b, groups, rngs) for a, b in pairwise(channels))
        cells = image_shape[0] * image_shape[1] // (folding * 2 ** len(LEVELS)) ** 2
        self.hidden = nnx.Linear(cells * channels[-1], NEURONS, rngs=rngs)
        self.out = nnx.Linear(NEURONS, 2 * num_keypoints, rngs=rngs)

    def __call__(self, images: Array) -> Array:
        """Keypoints `[B, K, 2]`, image units, from images `[B, H, W, 3]` in 0 to 1."""
        if self.background is not None:
            images = contrast(images, self.background[...])
        x = fold(images, self.folding)
        for block in (self.first, self.second, self.third, self.fourth):
            x = halve(block(x))
        coordinates = self.out(nnx.relu(self.hidden(x.reshape(x.shape[0], -1))))
        return coordinates.reshape(x.shape[0], -1, 2)


class FullyConnectedRenderer(nnx.Module):
    """Two fully connected layers, then four levels of convolutions, each doubled.

    Args:
        num_keypoints: K.
        image_shape: (H, W).
        width: channels at the finest level.
        groups: groups of the normalisations.
        folding: 1 works at full resolution; 2 unfolds channels to 2x2 pixels at the end.
        background: learn one logit per pixel that is added to the output.
        rngs: initialisation.
    """

    def __init__(
        self,
        num_keypoints: int,
        image_shape: tuple[int, int],
        width: int,
        groups: int,
        folding: int,
        background: bool,
        rngs: nnx.Rngs,
    ) -> None:
        self.folding = folding
        self.coarse = tuple(size // (folding * 2 ** len(LEVELS)) for size in image_shape)
        channels = [LEVELS[-1] * width, *(level * width for level in reversed(LEVELS))]
        self.hidden = nnx.Linear(2 * num_keypoints, NEURONS, rngs=rngs)
        self.spread = nnx.Linear(NEURONS, self.coarse[0] * self.coarse[1] * channels[0], rngs=rngs)
        self.first, self.second, self.third, self.fourth = (Block(a, b, groups, rngs) for a, b in pairwise(channels))
        init = nnx.initializers.variance_scaling(0.01 if background else 1.0, "fan_in", "normal")
        self.out = nnx.Conv(channels[-1], 3 * folding**2, (3, 3), kernel_init=init, rngs=rngs)
        self.background = nnx.Param(jnp.zeros((*image_shape, 3))) if background else None

    def __call__(self, keypoints: Array, pivot: Array) -> Array:
        """Images `[B, H, W, 3]` in 0 to 1 of keypoints `[B, K, 2]`, image units; `pivot` has no effect."""
        x = self.spread(nnx.relu(self.hidden(keypoints.reshape(keypoints.shape[0], -1))))
        x = x.reshape(x.shape[0], *self.coarse, -1)
        for block in (self.first, self.second, self.third, self.fourth):
            x = double(block(x))
        logits = unfold(self.out(x), self.folding)
        if self.background is not None:
            logits = logits + self.background[...]
        return nnx.sigmoid(logits)
