"""Keypoints where the learned pictures of the parts fit a frame best (analysis by synthesis)."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs.progress import progress
from keycld_model.modules import Parameters, Parts
from keycld_model.nets.hourglass import grid
from keycld_model.nets.rigid_parts import COVERED, SOFT
from keycld_model.numerics import evenly_spaced

Floats = NDArray[np.float32]
SPREAD = 0.02
"""Standard deviation of an estimated keypoint's error before it is aligned, image units (.6 of 64 pixels)."""
ITERATIONS = 3
"""Gauss-Newton steps a frame."""
SAMPLE = 400
"""Frames from which what holds for all is told."""
CHUNK = 100
"""Frames at a time."""


def align(
    parts: Parts, parameters: Parameters, frames: NDArray[np.uint8], positions: Floats, spread: Floats | float = SPREAD
) -> Floats:
    """Move keypoints to where the pictures of the rigid parts fit, each frame by itself and without constraints.

    Args:
        parts: of a configuration with `rigid_parts`.
        parameters: of the model.
        frames: `[B, H, W, 3]`.
        positions: `[B, n]` to begin from, image units.
        spread: standard deviation of their errors, or `[n]`, image units.

    Returns:
        `[B, n]`.
    """
    pixels = near(parts, parameters, positions)
    some = evenly_spaced(len(frames), SAMPLE)
    drawn: Any = jax.jit(jax.vmap(drawing(parts, parameters)))(positions[some], pixels[some])
    misfits = np.mean((np.asarray(drawn) - colours(frames[some], pixels[some])) ** 2, axis=(1, 2))
    noise = np.sqrt(np.median(misfits) + 1e-8)
    function, out = jax.jit(jax.vmap(_aligned(parts, parameters), (None, None, 0, 0, 0))), []
    with progress("Aligning keypoints with frames", total=len(frames)) as advance:
        for i in range(0, len(frames), CHUNK):
            rows = slice(i, i + CHUNK)
            seen = colours(frames[rows], pixels[rows])
            out.append(np.asarray(function(noise, spread, positions[rows], pixels[rows], seen)))
            advance(len(seen))
    return np.concatenate(out)


def drawing(parts: Parts, parameters: Parameters) -> Callable[[Array, Array], Array]:
    """Colours `[M, 3]` of a frame with the mechanism at `[n]`, at pixels with numbers `[M]`.

    What stands still is known from the frames. A gradient for pixels that a part seldom reaches would spoil them, since
    steps of Adam are as large there as elsewhere.
    """
    module, places = parts.appearance(parameters), _places(parts)
    still = jax.lax.stop_gradient(module.background[...].reshape(-1, 3))
    pivot = parameters["dynamics"]["pivot"]
    return lambda x, pixels: module.at(x.reshape(-1, 2), pivot, places[pixels], still[pixels])


def distances(parts: Parts, parameters: Parameters, positions: Floats) -> Floats:
    """`[B, H*W]` of every pixel from the nearest part, image units."""
    module, places, pivot = parts.appearance(parameters), _places(parts), parameters["dynamics"]["pivot"]
    function = jax.jit(jax.vmap(lambda x: module.distance(x.reshape(-1, 2), pivot, places)))
    return np.concatenate([np.asarray(function(positions[i : i + CHUNK])) for i in range(0, len(positions), CHUNK)])


def near(parts: Parts, parameters: Parameters, positions: Floats) -> NDArray[np.int32]:
    """Numbers `[B, M]` of the pixels within reach of the parts, in each frame as many as the most in any of some."""
    some = distances(parts, parameters, positions[evenly_spaced(len(positions), SAMPLE)])
    reach = float(parameters["appearance"]["reach"]) + 2 * SOFT
    count = int(np.clip((some < reach).sum(1).max(), 1, some.shape[1] // COVERED))
    rows = []
    for i in range(0, len(positions), CHUNK):
        every = distances(parts, parameters, positions[i : i + CHUNK])
        rows.append(np.argpartition(every, count - 1, axis=1)[:, :count].astype(np.int32))
    return np.concatenate(rows)


def colours(frames: NDArray[np.uint8], pixels: NDArray[np.int32]) -> Floats:
    """`[B, M, 3]`, 0 to 1, of frames `[B, H, W, 3]` at pixels with numbers `[B, M]`."""
    flat = frames.reshape(len(frames), -1, 3)
    return np.take_along_axis(flat, pixels[..., None], 1).astype(np.float32) / 255.0


def _places(parts: Parts) -> Array:
    """`[H*W, 2]` pixel centres, image units."""
    return grid(*parts.config.image_shape, 1).reshape(-1, 2)


def _aligned(parts: Parts, parameters: Parameters) -> Callable[[Array, Array, Array, Array, Array], Array]:
    """Positions `[n]` for standard deviations of colours and positions, where these begin, pixels and their colours."""
    draw = drawing(parts, parameters)

    def one(noise: Array, spread: Array, start: Array, pixels: Array, seen: Array) -> Array:
        def residual(z: Array) -> Array:
            return jnp.concatenate([((draw(start + z, pixels) - seen) / noise).ravel(), z / spread])

        def step(z: Array, _: None) -> tuple[Array, None]:
            error, jacobian = residual(z), jax.jacfwd(residual)(z)
            new = z - jnp.linalg.solve(jacobian.T @ jacobian, jacobian.T @ error)
            return jnp.where(jnp.sum(residual(new) ** 2) < jnp.sum(error**2), new, z), None

        return start + jax.lax.scan(step, jnp.zeros_like(start), None, length=ITERATIONS)[0]

    return one
