"""An agent that swings to and fro about its target believes images less, and damps more.

Near a target, keypoints may be read in steps: of a thin part that stands still, frames hardly change within a quarter
of a pixel, and an estimator that has seldom seen such poses makes the steps larger. To the loop that is a relay, about
which it swings (a limit cycle, as of any relay in a loop with delay). No innovation is large then, so no filter that
adapts to innovations notices it. What tells is that the mechanism goes away from its target again and again. Then the
model is followed more than images, and the reference motion is slower and more damped.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from keycld_control.observer import Estimate
from keycld_control.plant import Plant

NEAR = 0.1
"""Image units from the target of every keypoint, within which swinging is looked for; swings are a few hundredths."""
SLOW = 0.07
"""Image units per second of the fastest keypoint, up to which nothing is said to swing, with the usual noise of
keypoints: their steps alone look as fast as .065 on the reference systems. Half as much each time that something was
done, for estimates follow images less then."""
MEMORY = 1.0
"""Seconds over which the share of swinging is averaged."""
MUCH = 0.15
"""Share of the time that a mechanism goes away from its target, near it and faster than `SLOW`, that is a limit cycle:
a sine twice as fast has a third, and an approach that overshoots once passes in less than a tenth of a second."""
TIMES = 2
"""How often something is done about it, at most."""
NOISIER, MOST = 2.0, 0.04
"""Factor on the standard deviation of keypoints each time, and the most that it is raised to, image units: with more,
the small errors of a model carry it farther from the target than images are off."""
CALMER = 2.0**0.5
"""Factor on the damping each time, and the stiffness is divided by it: the way back to the target takes twice as
long."""


class Swinging(NamedTuple):
    """What is known of it.

    Attributes:
        share: of the last second, in which the mechanism went away from its target near it.
        times: how often that was too much.
    """

    share: Array
    times: Array

    def noise(self, plant: Plant) -> Array:
        """Standard deviation of keypoints to reckon with, image units."""
        most = max(MOST, plant.keypoint_noise)
        return jnp.minimum(plant.keypoint_noise * NOISIER**self.times, most)

    def gains(self, kp: float, kd: float) -> tuple[Array, Array]:
        """Stiffness, 1/s^2, and damping, 1/s, in place of the usual ones."""
        factor = CALMER**self.times
        return kp / factor, kd * factor


def no_swinging() -> Swinging:
    """At the beginning of an episode."""
    return Swinging(jnp.zeros(()), jnp.zeros(()))


def watched(plant: Plant, target: Array, before: Swinging, estimate: Estimate) -> Swinging:
    """With one more estimate; far from the target `[n]`, it is forgotten."""
    away, v = (estimate.x - target).reshape(-1, 2), estimate.v.reshape(-1, 2)
    near = jnp.max(jnp.sum(away**2, axis=1)) < NEAR**2
    fast = jnp.max(jnp.sum(v**2, axis=1)) > (SLOW * 0.5**before.times) ** 2
    outward = near & fast & (jnp.sum(away * v) > 0)
    share = before.share + (outward - before.share) * (plant.timestep / MEMORY)
    much = share > MUCH
    times = jnp.minimum(before.times + much, TIMES)
    return Swinging(jnp.where(much, 0.0, share), jnp.where(near, times, 0.0))
