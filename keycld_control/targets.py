"""From a target image to target keypoints, or the reason why it cannot be reached."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from keycld_control.plant import LearnedModel, Plant, project
from keycld_control.skeleton import turned
from keycld_envs.errors import InputError
from keycld_model import physics

LENGTH_TOLERANCE = 0.05
"""Deviation of a rod's length, or of a keypoint from its rail, that a target may have, image units."""
UNEXPLAINED = 0.25
"""Error of the rendered target keypoints, as a share of the difference between images of random configurations."""
POSES = 16


def check_image(name: str, image: Any, shape: tuple[int, int]) -> NDArray[np.uint8] | NDArray[np.float32]:
    """Return an image `[H, W, 3]`, uint8 or float32, if the model can read it.

    Args:
        name: what to call the image in an error.
        image: uint8, or float with values in 0..1.
        shape: (H, W) that the model was trained on.

    Raises:
        InputError: if it has another shape or type, or values out of range.
    """
    pixels = np.asarray(image)
    if pixels.shape != (*shape, 3):
        raise InputError(f"{name} has shape {pixels.shape}, but the model reads images of shape {(*shape, 3)}.")
    if pixels.dtype == np.uint8:
        return pixels
    if not np.issubdtype(pixels.dtype, np.floating):
        raise InputError(f"{name} has type {pixels.dtype}; it must be uint8, or float with values from 0 to 1.")
    if not (pixels.min() >= 0 and pixels.max() <= 1):  # also false for NaN
        raise InputError(f"{name} has values outside 0 to 1, or NaN; give uint8, or floats divided by 255.")
    return pixels.astype(np.float32)


def roughly(model: LearnedModel, plant: Plant, pixels: NDArray[Any]) -> Array:
    """A possible configuration `[n]`, near that of an image `[H, W, 3]` if the camera is the model's."""

    @jax.jit
    def see(pixels: Array) -> Array:
        keypoints = model.keypoints_fn(pixels)
        return project(plant, keypoints, jnp.zeros_like(keypoints), 5)[0]

    return see(jnp.asarray(pixels))


def find_target(model: LearnedModel, image: ArrayLike) -> Array:
    """Keypoints of a target image.

    Args:
        model: the world model.
        image: `[H, W, 3]`, uint8 or float in 0..1.

    Returns:
        `[n]` positions on the manifold, image units.

    Raises:
        InputError: if the image has another size than the model reads, shows no mechanism that the model knows, or
            shows it in a shape that its rods and sliders do not permit.
    """
    plant = Plant.of(model)
    pixels = check_image("The target image", image, model.image_shape)
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, len(model.mechanism.rods))).astype(np.float32)

    @jax.jit
    def examine(pixels: Array, angles: Array) -> tuple[Array, Array, Array, Array, Array]:
        keypoints = model.keypoints_fn(pixels)
        target, _ = project(plant, keypoints, jnp.zeros_like(keypoints), 5)
        levels = physics.constraint(plant.mechanism, keypoints, plant.pivot)
        rendered = model.render_fn(target)
        others = jax.lax.map(lambda a: model.render_fn(turned(plant.mechanism, target, a, plant.pivot)), angles)
        error = jnp.mean((rendered - as_float(pixels)) ** 2)
        return keypoints, target, levels, error, jnp.mean((others - rendered) ** 2)

    keypoints, target, levels, error, scale = examine(jnp.asarray(pixels), jnp.asarray(angles))
    if not np.isfinite(keypoints).all():
        raise InputError("No keypoints were found in the target image; show the mechanism as it was filmed.")
    _check_lengths(model, np.asarray(levels))
    if not float(error) <= UNEXPLAINED * float(scale):
        raise InputError(
            "The mechanism was not found in the target image: the image rendered from its keypoints differs from it "
            f"by {float(error):.2g} (mean squared error), images of other configurations by {float(scale):.2g}; show "
            "the mechanism as it was filmed, with the same camera and background."
        )
    return target


def as_float(pixels: Array) -> Array:
    """Pixels, uint8 or float in 0..1, as floats in 0..1."""
    return pixels.astype(jnp.float32) / 255 if pixels.dtype == jnp.uint8 else pixels


def _check_lengths(model: LearnedModel, found: NDArray[np.float32]) -> None:
    """Compare the constraint values `[c]` of the keypoints found with those of the model."""
    level = np.asarray(model.level)
    num_rods = len(model.mechanism.rods)
    for i, rod in enumerate(model.mechanism.rods):
        lengths = np.sqrt(2 * np.maximum([found[i], level[i]], 0))
        if not abs(lengths[0] - lengths[1]) <= LENGTH_TOLERANCE:
            start = "the pivot" if rod.start is None else f"keypoint {rod.start}"
            raise InputError(
                f"The target is no possible configuration: the rod from {start} to keypoint {rod.end} is "
                f"{lengths[0]:.3f} image units long in the target image, but {lengths[1]:.3f} in the model."
            )
    for slider, offset in zip(model.mechanism.sliders, found[num_rods:] - level[num_rods:], strict=True):
        if not abs(offset) <= LENGTH_TOLERANCE * np.linalg.norm(slider.normal):
            raise InputError(
                f"The target is no possible configuration: keypoint {slider.keypoint} is {offset:+.3f} image units "
                "off its rail in the target image."
            )
