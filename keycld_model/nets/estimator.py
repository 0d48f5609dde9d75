"""Images to keypoints (KeyCLD paper, section 3, equation 8)."""

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_model.nets.hourglass import Hourglass, fold, grid

CONTRAST = 5.0
"""Brings differences between a frame and the mean frame to unit order."""


class KeypointEstimator(nnx.Module):
    """Fully convolutional keypoint estimator with a spatial softmax.

    With `saliency` above zero the heatmaps start from where the frame differs from the mean frame, so that keypoints
    ride on what moves from the first step on; without it they start at the image centre and often settle on the far
    side of the pivot.

    Args:
        num_keypoints: K.
        image_shape: (H, W).
        width: channels of the hourglass.
        groups: groups of its normalisation.
        folding: 1 works at full resolution as in the paper; 2 folds 2x2 pixels into channels first.
        saliency: height of a smooth bump in the heatmaps where the frame differs most from the mean frame; 0 feeds raw
            images, as in the paper.
        rngs: initialisation.
    """

    def __init__(
        self,
        num_keypoints: int,
        image_shape: tuple[int, int],
        width: int,
        groups: int,
        folding: int,
        saliency: float,
        rngs: nnx.Rngs,
    ) -> None:
        self.folding = folding
        self.saliency = saliency
        self.background = nnx.Param(jnp.full((*image_shape, 3), 0.5)) if saliency else None
        self.hourglass = Hourglass(3 * folding**2, num_keypoints, width, groups, rngs, 0.1 if saliency else 1.0)

    def heatmaps(self, images: Array) -> Array:
        """Logits `[B, H/f, W/f, K]` of where each keypoint is, from images `[B, H, W, 3]` in 0 to 1."""
        if self.background is None:
            return self.hourglass(fold(images, self.folding))
        difference = fold(contrast(images, self.background[...]), self.folding)
        salient = blur(jnp.mean(difference**2, axis=-1, keepdims=True))
        salient = salient / (jnp.max(salient, axis=(1, 2), keepdims=True) + 1e-6)
        return self.hourglass(difference) + self.saliency * jax.lax.stop_gradient(salient)

    def __call__(self, images: Array) -> Array:
        """Keypoints `[B, K, 2]` in image units from images `[B, H, W, 3]` in 0 to 1 (paper, equation 8)."""
        logits = self.heatmaps(images)
        b, h, w, k = logits.shape
        probability = jax.nn.softmax(logits.reshape(b, h * w, k), axis=1)
        cells = grid(h * self.folding, w * self.folding, self.folding).reshape(h * w, 2)
        return jnp.einsum("bpk,pd->bkd", probability, cells)


def contrast(images: Array, background: Array) -> Array:
    """Differences `[B, H, W, C]` to the mean frame `[H, W, C]`, of unit order; they do not teach the background."""
    return CONTRAST * (images - jax.lax.stop_gradient(background))


def blur(x: Array, size: int = 5) -> Array:
    """Two box averages over `size` cells each way, `[B, H, W, C]`.

    A sharp bump would make keypoints jump from cell to cell.
    """
    for _ in range(2):
        x = jax.lax.reduce_window(x, 0.0, jax.lax.add, (1, size, size, 1), (1, 1, 1, 1), "SAME") / size**2
    return x
