"""Whether an image shows the mechanism: what an agent asks before it acts on one.

What differs from the background must lie where the keypoints say the mechanism is, and the keypoints must be as far
from each other as its rods. The rest must not be more like the background mirrored: that is a world in which motors
push the other way. The background is the median of what the model draws of many configurations, and how much may differ
is what it draws at most; nothing of this needs other images than the model's own.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_control.plant import LearnedModel, Plant, project
from keycld_control.skeleton import turned
from keycld_control.targets import LENGTH_TOLERANCE, as_float
from keycld_model import physics
from keycld_model.nets.segments import squared_distance

EVERY = 2
"""Rows apart are the pixels that are looked at, in all columns, for each has its mirrored one."""
POSES = 48
"""Configurations that are drawn to know the background."""
REACH = 0.5
"""Image units along a rail within which they are drawn."""
NEAR = 0.25
"""Image units from the mechanism's skeleton within which it is seen."""
DISTINCT = 0.02
"""Difference of a background pixel from its mean with the mirrored one, of 1, below which it is the drawing's own
error, five grey levels. A plain background looks alike in a mirror, which then tells nothing."""
MIRRORED = 0.5
"""How much of what tells the background from its mirror image must be mirrored: 1 of a mirrored one, -1 of the
background itself, and about 0 where both are alike but for errors of the drawing."""
NOTICED = 0.1
"""Difference of a pixel's mean over the colours, of 1, below which it may be noise or light."""
MORE = 0.01
"""Share of an image that may differ elsewhere beside what the model draws there."""
LESS = 0.3
"""Share of what the model draws at least that must be seen where the mechanism is."""


class Plausibility(NamedTuple):
    """What images of a mechanism have in common.

    Attributes:
        drawn: `[POSES, H, W, 3]` images of random configurations, 0 to 1.
        background: `[H, W, 3]` without the mechanism, 0 to 1.
        even: `[h, W, 3]` mean of the background and the background mirrored, every second row; the background, where
            both are alike.
        grid: `[h, W, 2]` places of these pixels, image units.
        tolerance: `[c]` by which constraints of keypoints may be off.
        least: sum of differences from the background, of pixels near the mechanism, at least.
        most: the same of the others, at most.
    """

    drawn: Array
    background: Array
    even: Array
    grid: Array
    tolerance: Array
    least: float
    most: float


def expect(model: LearnedModel, plant: Plant, configuration: Array) -> Plausibility:
    """Learn it from what a model draws.

    Args:
        model: the world model.
        plant: its mechanics.
        configuration: `[n]` a possible one.
    """
    rng, mechanism = np.random.default_rng(0), model.mechanism
    angles = rng.uniform(-np.pi, np.pi, (POSES, len(mechanism.rods))).astype(np.float32)
    along = rng.uniform(-REACH, REACH, POSES).astype(np.float32)
    rail = np.zeros(2, np.float32)
    for slider in mechanism.sliders:
        rail = np.array([slider.normal[1], -slider.normal[0]], np.float32) / np.linalg.norm(slider.normal)

    def pose(angle: Array, shift: Array) -> Array:
        moved = turned(mechanism, configuration, angle, plant.pivot) + jnp.tile(shift * rail, mechanism.num_keypoints)
        return project(plant, moved, jnp.zeros_like(moved), 5)[0]

    poses = jax.jit(jax.vmap(pose))(angles, along)
    drawn = jax.jit(lambda poses: jax.lax.map(model.render_fn, poses))(poses)
    height, width = model.image_shape
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, width), np.linspace(1, -1, height)), axis=-1).astype(np.float32)
    lengths = [np.sqrt(2 * max(float(level), 0.0)) for level in np.asarray(model.level)[: len(mechanism.rods)]]
    lengths += [float(np.linalg.norm(slider.normal)) for slider in mechanism.sliders]
    background = np.median(drawn, axis=0)
    known = Plausibility(
        drawn,
        jnp.asarray(background),
        jnp.asarray(evened(background)[::EVERY]),
        jnp.asarray(grid[::EVERY]),
        LENGTH_TOLERANCE * jnp.asarray(np.array(lengths, np.float32)),
        0.0,
        np.inf,
    )
    near, far, _ = jax.jit(jax.vmap(lambda image, x: differences(plant, known, image, x)))(drawn, poses)
    return known._replace(
        least=LESS * float(near.min()), most=float(far.max()) + MORE * known.grid[..., 0].size * (1 - NOTICED)
    )


def evened(background: NDArray[np.floating]) -> NDArray[np.floating]:
    """`[H, W, 3]` mean of a background and the background mirrored; the background, where both are alike."""
    even = (background + background[:, ::-1]) / 2
    return np.where(np.abs(background - even) > DISTINCT, even, background)


def shows_mechanism(plant: Plant, known: Plausibility, image: Array, keypoints: Array) -> Array:
    """Whether an image `[H, W, 3]`, uint8 or float in 0..1, shows the mechanism at the keypoints `[n]` found in it."""
    off = jnp.abs(physics.constraint(plant.mechanism, keypoints, plant.pivot) - plant.level)
    near, far, mirrored = differences(plant, known, image, keypoints)
    return jnp.all(off <= known.tolerance) & (near >= known.least) & (far <= known.most) & ~mirrored


def differences(plant: Plant, known: Plausibility, image: Array, keypoints: Array) -> tuple[Array, Array, Array]:
    """Sums of what differs from the background near the keypoints' skeleton, and elsewhere; is the rest mirrored."""
    points, rods = keypoints.reshape(-1, 2), plant.mechanism.rods
    ends = [(plant.pivot if rod.start is None else points[rod.start], points[rod.end]) for rod in rods]
    alone = set(range(len(points))) - {k for rod in rods for k in (rod.start, rod.end)}
    ends += [(points[k], points[k]) for k in sorted(alone)]
    distance = jnp.min(jnp.stack([squared_distance(known.grid, start, end) for start, end in ends]), axis=0)
    pixels, background = as_float(image[::EVERY]), known.background[::EVERY]
    differs = jnp.maximum(jnp.mean(jnp.abs(pixels - background), axis=-1) - NOTICED, 0.0)
    near = distance < NEAR**2
    covered = (differs > 0) | near  # about a pivot, no image shows what is behind
    odd = jnp.where((covered | covered[:, ::-1])[..., None], 0.0, background - known.even)
    mirrored = jnp.sum((pixels - known.even) * odd) < -MIRRORED * jnp.sum(odd**2)
    return jnp.sum(differs * near), jnp.sum(differs * ~near), mirrored
