"""An agent that swings to and fro about its target believes images less, and its model more.

Near a target, keypoints may be read in steps: of a thin part that stands still, frames hardly change within a quarter
of a pixel, and an estimator that has seldom seen such poses makes the steps larger. To the loop that is a relay, about
which it swings (a limit cycle, as of any relay in a loop with delay). No innovation is large then, so no filter that
adapts to innovations notices it. What tells is that the mechanism goes away from its target again and again.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from keycld_control.observer import Estimate
from keycld_control.plant import KEYPOINT_NOISE, Plant

NEAR = 0.1
"""Image units from the target of every keypoint, within which swinging is looked for; swings are a few hundredths."""
SLOW = 0.07
"""Image units per second of the fastest keypoint, up to which nothing is said to swing, with the usual noise of
keypoints: their steps alone look as fast as .065 on the reference systems. With more noise, estimates follow them less,
as its square root."""
MEMORY = 1.0
"""Seconds over which the share of swinging is averaged."""
MUCH = 0.15
"""Share of the time that a mechanism goes away from its target, near it and faster than `SLOW`, that is a limit cycle:
a sine twice as fast has a third, and an approach that overshoots once passes in less than a tenth of a second."""
LESS = 2.0
"""Factor on the standard deviation of keypoints each time."""
MOST = 0.06
"""Image units (two of 64 pixels), the most that they are thought to be off by; positions are the model's then."""


class Swinging(NamedTuple):
    """What is known of it.

    Attributes:
        share: of the last second, in which the mechanism went away from its target near it.
        noise: standard deviation of keypoints that the agent reckons with, image units.
    """

    share: Array
    noise: Array


def no_swinging(plant: Plant) -> Swinging:
    """At the beginning of an episode."""
    return Swinging(jnp.zeros(()), jnp.asarray(plant.keypoint_noise))


def watched(plant: Plant, target: Array, before: Swinging, estimate: Estimate) -> Swinging:
    """With one more estimate; far from the target `[n]`, images are believed as ever."""
    away = (estimate.x - target).reshape(-1, 2)
    v = estimate.v.reshape(-1, 2)
    near = jnp.max(jnp.sum(away**2, axis=1)) < NEAR**2
    slow = SLOW**2 * KEYPOINT_NOISE / before.noise
    outward = near & (jnp.max(jnp.sum(v**2, axis=1)) > slow) & (jnp.sum(away * v) > 0)
    share = before.share + (outward - before.share) * (plant.timestep / MEMORY)
    swings = share > MUCH
    noise = jnp.where(swings, jnp.minimum(LESS * before.noise, jnp.maximum(MOST, before.noise)), before.noise)
    return Swinging(jnp.where(swings, 0.0, share), jnp.where(near, noise, plant.keypoint_noise))
