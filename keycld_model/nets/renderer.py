"""Keypoints to images (KeyCLD paper, section 3, equation 9)."""

import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_model.nets.hourglass import Hourglass, fold, grid, unfold
from keycld_model.nets.segments import Segment, squared_distance


class Renderer(nnx.Module):
    """Draws a frame from Gaussian maps around the keypoints and a learned constant tensor.

    Args:
        num_keypoints: K.
        segments: lines whose distance maps are drawn beside the Gaussians; the paper has none.
        image_shape: (H, W).
        width: channels of the hourglass.
        groups: groups of its normalisation.
        folding: 1 works at full resolution as in the paper; 2 unfolds channels to 2x2 pixels at the end.
        constants: channels of the learned constant tensor.
        gaussian_widths: standard deviations of the Gaussian maps, image units; the paper has one.
        segment_widths: standard deviations of the distance maps, image units.
        background: learn one logit per pixel that is added to the output.
        rngs: initialisation.
    """

    def __init__(
        self,
        num_keypoints: int,
        segments: tuple[Segment, ...],
        image_shape: tuple[int, int],
        width: int,
        groups: int,
        folding: int,
        constants: int,
        gaussian_widths: tuple[float, ...],
        segment_widths: tuple[float, ...],
        background: bool,
        rngs: nnx.Rngs,
    ) -> None:
        self.segments = segments
        self.image_shape = image_shape
        self.folding = folding
        self.gaussian_widths = gaussian_widths
        self.segment_widths = segment_widths
        h, w = image_shape[0] // folding, image_shape[1] // folding
        self.constant = nnx.Param(nnx.initializers.normal(1.0)(rngs.params(), (h, w, constants)))
        self.background = nnx.Param(jnp.zeros((*image_shape, 3))) if background else None
        maps = num_keypoints * len(gaussian_widths) + len(segments) * len(segment_widths)
        self.hourglass = Hourglass(
            maps * folding**2 + constants, 3 * folding**2, width, groups, rngs, 0.1 if background else 1.0
        )

    def maps(self, keypoints: Array, pivot: Array) -> Array:
        """Gaussian maps (equation 9), then distance maps of the segments, `[B, H, W, C]`."""
        cells = grid(*self.image_shape, 1)[None]
        points = [keypoints[:, k] for k in range(keypoints.shape[1])]
        squared = [(jnp.sum((cells - p[:, None, None]) ** 2, -1), self.gaussian_widths) for p in points]
        for start, end in self.segments:
            a = jnp.broadcast_to(pivot, points[end].shape) if start is None else points[start]
            squared.append((squared_distance(cells, a[:, None, None], points[end][:, None, None]), self.segment_widths))
        return jnp.stack([jnp.exp(-d / (2 * s**2)) for d, widths in squared for s in widths], axis=-1)

    def __call__(self, keypoints: Array, pivot: Array) -> Array:
        """Images `[B, H, W, 3]` in 0 to 1.

        Args:
            keypoints: `[B, K, 2]`, image units.
            pivot: `[2]`, image units.
        """
        maps = fold(self.maps(keypoints, pivot), self.folding)
        constant = jnp.broadcast_to(self.constant[...], (maps.shape[0], *self.constant[...].shape))
        logits = unfold(self.hourglass(jnp.concatenate([constant, maps], axis=-1)), self.folding)
        if self.background is not None:
            logits = logits + self.background[...]
        return nnx.sigmoid(logits)
