"""Positions and velocities from one image after another: a Kalman filter that predicts with the learned dynamics.

A difference of keypoints is late by half its window and noisy. Here the model itself moves the estimate from one frame
to the next, under the action that was really applied, so the estimate is not late; the new keypoints only correct it.
The correction is that of the steady-state Kalman filter for a point under white acceleration noise, the same for all
coordinates, started with an unknown velocity, so that the first frames count more.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from keycld_control.plant import Plant, advanced, project

ACCELERATION_NOISE = 2.0
"""Standard deviation of the model's acceleration, image units per second squared."""
INITIAL_SPEED = 3.0
"""Standard deviation of the unknown velocity in the first frame, image units per second."""
LOST = 0.25
"""Keypoints further than this from their prediction, image units, are those of another motion."""


class Estimate(NamedTuple):
    """What the observer knows.

    Attributes:
        x: `[n]` positions, on the manifold.
        v: `[n]` velocities, tangent to it.
        covariance: `[3]` variance of a position, covariance with its velocity, variance of the velocity.
    """

    x: Array
    v: Array
    covariance: Array


def first_estimate(plant: Plant, keypoints: Array) -> Estimate:
    """Start at keypoints `[n]`, at rest but uncertain of it."""
    x, v = project(plant, keypoints, jnp.zeros_like(keypoints), iterations=3)
    return Estimate(x, v, jnp.array([plant.keypoint_noise**2, 0.0, INITIAL_SPEED**2], keypoints.dtype))


def predicted(plant: Plant, estimate: Estimate, action: Array) -> Estimate:
    """What is known one frame later, under the action `[m]`, before anything is seen."""
    h = plant.timestep
    x, v = advanced(plant, estimate.x, estimate.v, action)
    p, c, s = estimate.covariance
    q = ACCELERATION_NOISE**2
    covariance = jnp.stack([p + 2 * h * c + h**2 * s + q * h**4 / 4, c + h * s + q * h**3 / 2, s + q * h**2])
    return Estimate(x, v, covariance)


def corrected(plant: Plant, prior: Estimate, keypoints: Array, noise: ArrayLike) -> Estimate:
    """What is known with the keypoints `[n]` seen, which are off by `noise` (standard deviation, image units)."""
    p, c, s = prior.covariance
    innovation = p + jnp.square(noise)
    gain_x, gain_v = p / innovation, c / innovation
    surprise = keypoints - prior.x
    x, v = project(plant, prior.x + gain_x * surprise, prior.v + gain_v * surprise)
    return Estimate(x, v, jnp.stack([(1 - gain_x) * p, (1 - gain_x) * c, s - gain_v * c]))


def choose(condition: Array, one: Estimate, other: Estimate) -> Estimate:
    """One estimate where a condition holds, and another where it does not."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)
