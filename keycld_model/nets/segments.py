"""How far pixels are from the lines between keypoints."""

import jax.numpy as jnp
from jax import Array

Segment = tuple[int | None, int]
"""A line between two keypoints, or from the fixed pivot (None) to a keypoint."""


def squared_distance(places: Array, start: Array, end: Array) -> Array:
    """Of places `[..., 2]` from the lines between `start` and `end`, `[2]` or whatever fits the places' shape."""
    along, to = end - start, places - start
    share = jnp.clip(jnp.sum(to * along, -1) / (jnp.sum(along**2, -1) + 1e-6), 0.0, 1.0)
    return jnp.sum((to - share[..., None] * along) ** 2, -1)
