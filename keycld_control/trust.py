"""Whether the images of an episode agree with each other and with the motion that the model predicts.

An image that shows the mechanism may still be an old one, or one of another motion. What is seen must lie near its
prediction, and over some frames within what noise and the model's errors explain; and a mechanism that should move
does not show the same image again. Where this fails, the estimate begins anew, and is not acted on before images agree
again, the longer the more often it has failed; if they repeat, not before the mechanism should have moved.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from keycld_control.observer import LOST, Estimate, choose, corrected, first_estimate, predicted
from keycld_control.plant import Plant

DOUBTFUL = 12.0
"""Mean squared surprise, in variances, that is too much; the reference systems stay below 6.1 undisturbed."""
MEMORY = 4
"""Images over which it is averaged."""
DOUBT, MOST_DOUBT = 30.0, 1e4
"""Where it begins anew, so that four images must agree, and at most, which are 24."""
FROZEN = 0.02
"""Image units that a mechanism should have moved, at least, while images repeat each other bit for bit."""
FROZEN_AFTER = 0.2
"""Seconds over which such a motion is predicted; later, errors of the model count."""


class Trust(NamedTuple):
    """What is thought of the images so far.

    Attributes:
        doubt: mean squared surprise, in variances.
        beginning: the estimate has begun anew, and doubt is not yet gone.
        unseen: images in a row that did not show the mechanism (integer).
        ghost: where the mechanism would be by now, since images began to repeat each other.
        repeats: images since then (integer).
    """

    doubt: Array
    beginning: Array
    unseen: Array
    ghost: Estimate
    repeats: Array


def first_trust(estimate: Estimate, unseen: Array) -> Trust:
    """In the first estimate of an episode."""
    return Trust(jnp.zeros(()), jnp.array(False), unseen, estimate, jnp.array(0))


def trusted(trust: Trust) -> Array:
    """Whether the last image was one to act on."""
    return (trust.unseen == 0) & ~trust.beginning


def surprise(prior: Estimate, keypoints: Array) -> Array:
    """How far the keypoint that is farthest from its prediction lies from it, image units; NaN if one is missing."""
    return jnp.max(jnp.sqrt(jnp.sum((keypoints - prior.x).reshape(-1, 2) ** 2, axis=1)))


def judged(
    plant: Plant,
    trust: Trust,
    prior: Estimate,
    action: Array,
    keypoints: Array,
    shown: Array,
    repeated: Array,
    blind: Array,
    noise: ArrayLike,
) -> tuple[Estimate, Trust]:
    """The estimate with one more image, as far as it can be trusted, and what is thought of images then.

    Args:
        plant: the model.
        trust: before.
        prior: what was predicted.
        action: `[m]` that has been applied.
        keypoints: `[n]` found in the image.
        shown: the image shows the mechanism (scalar bool).
        repeated: it is the image before, bit for bit (scalar bool).
        blind: too many images did not, for the prediction to count (scalar bool).
        noise: standard deviation of keypoints, image units.
    """
    ghost = jax.lax.cond(repeated, lambda: predicted(plant, trust.ghost, action), lambda: trust.ghost)
    frozen = repeated & (surprise(ghost, keypoints) > FROZEN)
    shown = shown & ~frozen
    off = surprise(prior, keypoints)
    doubt = trust.doubt + (off**2 / (prior.covariance[0] + jnp.square(noise)) - trust.doubt) / MEMORY
    agrees = shown & ~blind & (off < LOST) & (trust.beginning | (doubt < DOUBTFUL))  # also false for NaN
    anew = shown & ~agrees
    estimate = jax.lax.cond(
        anew,
        lambda: first_estimate(plant, keypoints),
        lambda: choose(agrees, corrected(plant, prior, keypoints, noise), prior),
    )
    doubt = jnp.where(anew, jnp.clip(2 * trust.doubt, DOUBT, MOST_DOUBT), jnp.where(agrees, doubt, trust.doubt))
    fresh = ~repeated | (trust.repeats * plant.timestep > FROZEN_AFTER)
    return estimate, Trust(
        doubt,
        anew | (trust.beginning & ~(agrees & fresh & (doubt < DOUBTFUL))),
        jnp.where(shown, 0, jnp.minimum(jnp.maximum(trust.unseen, jnp.where(frozen, trust.repeats, 0)) + 1, 10_000)),
        choose(fresh, estimate, ghost),
        jnp.where(fresh, 0, trust.repeats + 1),
    )
