"""Holonomic constraints of a declared mechanism, with their derivatives in closed form.

A rod between p and q is Phi = |q - p|^2 / 2, a slider is Phi = normal . (x - pivot). Only the derivatives of Phi enter
the equations of motion, so rod lengths need not be known (KeyCLD paper, section 2).
"""

import jax.numpy as jnp
from jax import Array

from keycld_envs.mechanism import Mechanism, Rod


def _rod_vector(mechanism: Mechanism, rod: Rod, points: Array, pivot: Array) -> Array:
    start = pivot if rod.start is None else points[rod.start]
    return points[rod.end] - start


def constraint(mechanism: Mechanism, x: Array, pivot: Array | None = None) -> Array:
    """Phi(x): constant along every motion the mechanism can make.

    Args:
        mechanism: the declaration.
        x: `[n]` keypoint positions, image units.
        pivot: `[2]` position of the fixed pivot; the declared one when absent.

    Returns:
        `[c]`: half the squared length of each rod, then the offset of each slider from its rail.
    """
    points = x.reshape(-1, 2)
    pivot = jnp.asarray(mechanism.pivot, x.dtype) if pivot is None else pivot
    values = [0.5 * jnp.sum(_rod_vector(mechanism, rod, points, pivot) ** 2) for rod in mechanism.rods]
    values += [jnp.dot(jnp.asarray(s.normal, x.dtype), points[s.keypoint] - pivot) for s in mechanism.sliders]
    return jnp.stack(values) if values else jnp.zeros((0,), x.dtype)


def constraint_jacobian(mechanism: Mechanism, x: Array, pivot: Array | None = None) -> Array:
    """D Phi(x), `[c, n]`; arguments as in `constraint`."""
    points = x.reshape(-1, 2)
    pivot = jnp.asarray(mechanism.pivot, x.dtype) if pivot is None else pivot
    zero = jnp.zeros((2,), x.dtype)
    rows = []
    for rod in mechanism.rods:
        d = _rod_vector(mechanism, rod, points, pivot)
        blocks = [zero] * mechanism.num_keypoints
        blocks[rod.end] = d
        if rod.start is not None:
            blocks[rod.start] = -d
        rows.append(jnp.concatenate(blocks))
    for slider in mechanism.sliders:
        blocks = [zero] * mechanism.num_keypoints
        blocks[slider.keypoint] = jnp.asarray(slider.normal, x.dtype)
        rows.append(jnp.concatenate(blocks))
    return jnp.stack(rows) if rows else jnp.zeros((0, x.shape[0]), x.dtype)


def constraint_curvature(mechanism: Mechanism, v: Array) -> Array:
    """<D^2 Phi, v> v: the part of Phi'' that is quadratic in the velocity.

    Args:
        mechanism: the declaration.
        v: `[n]` keypoint velocities, image units per second.

    Returns:
        `[c]`; for these constraints it does not depend on the positions.
    """
    speeds = v.reshape(-1, 2)
    values = [
        jnp.sum((speeds[rod.end] - (0.0 if rod.start is None else speeds[rod.start])) ** 2) for rod in mechanism.rods
    ]
    values += [jnp.zeros((), v.dtype) for _ in mechanism.sliders]
    return jnp.stack(values) if values else jnp.zeros((0,), v.dtype)
