"""A mechanism as a tree of rods: from positions to rod vectors and back, and how far each rod has to turn."""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs.mechanism import Mechanism


def rod_vectors(mechanism: Mechanism, x: Array, pivot: Array) -> Array:
    """`[R, 2]` vectors from the start of every rod to its end; of velocities `[n]` with a zero pivot, their rates."""
    points = x.reshape(-1, 2)
    starts = [pivot if rod.start is None else points[rod.start] for rod in mechanism.rods]
    vectors = [points[rod.end] - start for rod, start in zip(mechanism.rods, starts, strict=True)]
    return jnp.stack(vectors) if vectors else jnp.zeros((0, 2), x.dtype)


def assemble(mechanism: Mechanism, rods: Array, roots: Array) -> Array:
    """The inverse of `rod_vectors`: add up rod vectors along the mechanism.

    Args:
        mechanism: the declaration. In a closed chain of rods, the least-squares solution.
        rods: `[R, 2]` one vector per rod.
        roots: `[n_roots, 2]` one vector per keypoint that no rod ends in.

    Returns:
        `[n]`; positions relative to the pivot, or displacements, or velocities, as the arguments are.
    """
    return (jnp.asarray(_paths(mechanism), rods.dtype) @ jnp.concatenate([rods, roots])).reshape(-1)


def root_keypoints(mechanism: Mechanism) -> NDArray[np.intp]:
    """Indices of the keypoints that no rod ends in."""
    ends = {rod.end for rod in mechanism.rods}
    return np.array([k for k in range(mechanism.num_keypoints) if k not in ends], np.intp)


def turning_error(mechanism: Mechanism, x: Array, target: Array, pivot: Array) -> Array:
    """The velocity that, every rod turning at a constant rate, would take the mechanism from target to x in 1 s.

    Close to the target this is x - target. Unlike x - target, it is not orthogonal to all possible motions anywhere
    else, for instance when the mechanism hangs upside down: every rod's share is its angle from the target, in
    (-pi, pi], times its length.

    Args:
        mechanism: the declaration.
        x: `[n]` positions on the manifold.
        target: `[n]` positions on the manifold.
        pivot: `[2]`.

    Returns:
        `[n]`, tangent to the manifold at x.
    """
    now, then = rod_vectors(mechanism, x, pivot), rod_vectors(mechanism, target, pivot)
    angle = jnp.arctan2(then[:, 0] * now[:, 1] - then[:, 1] * now[:, 0], jnp.sum(then * now, axis=1))
    return assemble(mechanism, angle[:, None] * _turn(now), (x - target).reshape(-1, 2)[root_keypoints(mechanism)])


def centripetal_acceleration(mechanism: Mechanism, x: Array, v: Array, pivot: Array) -> Array:
    """Acceleration x'' `[n]` when every rod keeps turning at its rate, and every root keeps its velocity."""
    rods, rates = rod_vectors(mechanism, x, pivot), rod_vectors(mechanism, v, jnp.zeros_like(pivot))
    squared_rate = jnp.sum(rates**2, axis=1) / jnp.maximum(jnp.sum(rods**2, axis=1), 1e-12)
    roots = jnp.zeros((len(root_keypoints(mechanism)), 2), x.dtype)
    return assemble(mechanism, -squared_rate[:, None] * rods, roots)


def turned(mechanism: Mechanism, x: Array, angles: Array, pivot: Array) -> Array:
    """Positions `[n]` after turning every rod of x by angles `[R]` (rad, counter-clockwise), roots in place."""
    rods = rod_vectors(mechanism, x, pivot)
    rods = jnp.cos(angles)[:, None] * rods + jnp.sin(angles)[:, None] * _turn(rods)
    roots = (x.reshape(-1, 2) - pivot)[root_keypoints(mechanism)]
    return assemble(mechanism, rods, roots) + jnp.tile(pivot, mechanism.num_keypoints)


def _turn(vectors: Array) -> Array:
    """Vectors `[..., 2]` turned by a quarter, counter-clockwise."""
    return jnp.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


@cache
def _paths(mechanism: Mechanism) -> NDArray[np.floating]:
    """`[K, R + n_roots]`: which rods and roots add up to which keypoint."""
    rows = np.zeros((len(mechanism.rods), mechanism.num_keypoints))
    for row, rod in zip(rows, mechanism.rods, strict=True):
        row[rod.end] = 1
        if rod.start is not None:
            row[rod.start] = -1
    return np.linalg.pinv(np.concatenate([rows, np.eye(mechanism.num_keypoints)[root_keypoints(mechanism)]]))
