"""Where masses are, beside where keypoints are seen: what pictures leave open and motion tells."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jax import Array

from keycld_envs.mechanism import Mechanism


def to_masses(mechanism: Mechanism, variables: Mapping[str, Any], x: Array) -> Array:
    """Positions of the masses `[..., n]` for keypoints seen at x; linear, so that it serves velocities, too.

    Args:
        mechanism: the declaration.
        variables: "rod_scale" and "lean", `[K]` each, see `slide_along_rods` and `lean_along_rails`.
        x: `[..., n]`.
    """
    return slide_along_rods(mechanism, variables["rod_scale"], lean_along_rails(mechanism, -variables["lean"], x))


def to_keypoints(mechanism: Mechanism, variables: Mapping[str, Any], x: Array) -> Array:
    """Where keypoints are seen `[..., n]` for masses at x; the inverse of `to_masses`."""
    return lean_along_rails(mechanism, variables["lean"], slide_along_rods(mechanism, -variables["rod_scale"], x))


def end_rods(mechanism: Mechanism) -> list[tuple[int, int]]:
    """Rods (start, end) between keypoints at whose end nothing else is attached."""
    attached = [r.start for r in mechanism.rods] + [s.keypoint for s in mechanism.sliders]
    ends = [r.end for r in mechanism.rods]
    return [
        (r.start, r.end)
        for r in mechanism.rods
        if r.start is not None and r.end not in attached and ends.count(r.end) == 1
    ]


def inner_rods(mechanism: Mechanism) -> list[tuple[int, int]]:
    """The other rods (start, end) between keypoints, at whose end more is attached: links between two joints."""
    ends = end_rods(mechanism)
    return [(r.start, r.end) for r in mechanism.rods if r.start is not None and (r.start, r.end) not in ends]


def sliding_rods(mechanism: Mechanism) -> list[tuple[int, int]]:
    """Rods (start, end) between keypoints that alone hold their end and what hangs on it, each after its start's."""
    holders = [r.end for r in mechanism.rods] + [s.keypoint for s in mechanism.sliders]
    free = [
        (r.start, r.end)
        for r in mechanism.rods
        if r.start is not None and all(holders.count(k) == 1 for k in carried(mechanism, r.end))
    ]
    return sorted(free, key=lambda rod: -len(carried(mechanism, rod[1])))


def slide_along_rods(mechanism: Mechanism, log_scale: Array, x: Array) -> Array:
    """Move the end of each rod of `sliding_rods` along it, with all that hangs on it, by a factor on the rod's length.

    A single point mass stands for a whole link only at one distance from the joint (paper, appendix A.3), and pictures
    do not show where that is. Nor do they show where along a link its next joint is: a keypoint beside that joint, and
    all after it as far beside theirs, keep every constraint. Motion tells both, without touching the images.

    Args:
        mechanism: the declaration.
        log_scale: `[K]` logarithms of the factors; used for ends of such rods only.
        x: `[..., n]` positions.

    Returns:
        `[..., n]`.
    """
    seen = [x[..., 2 * k : 2 * k + 2] for k in range(mechanism.num_keypoints)]
    points = list(seen)
    for start, end in sliding_rods(mechanism):
        points[end] = points[start] + jnp.exp(log_scale[end]) * (seen[end] - seen[start])
    return jnp.concatenate(points, axis=-1)


def rails(mechanism: Mechanism) -> list[tuple[int, int]]:
    """Keypoints on sliders at which rods start, each with the end of the first of these rods."""
    on = {slider.keypoint for slider in mechanism.sliders}
    first = {rod.start: rod.end for rod in reversed(mechanism.rods) if rod.start in on}
    return [(start, end) for start, end in sorted(first.items()) if start is not None]


def lean_along_rails(mechanism: Mechanism, lean: Array, x: Array) -> Array:
    """Move what a slider carries along its rail, by a fraction of how far its rod reaches along it.

    A rod in front of a cart draws the cart's keypoint to its side, and the other keypoints follow, for rods are rigid;
    no constraint and no picture objects. In the equations of motion the lean looks like a mass at the rod's end: one
    percent of the rod is fifteen percent of the mass of dm_control's pole.

    Args:
        mechanism: the declaration.
        lean: `[K]` fractions; used for keypoints on sliders at which rods start.
        x: `[..., n]` positions.

    Returns:
        `[..., n]`.
    """
    points = x.reshape(*x.shape[:-1], -1, 2)
    ends = dict(rails(mechanism))
    for slider in mechanism.sliders:
        if (end := ends.get(start := slider.keypoint)) is None:
            continue
        along = jnp.asarray(slider.along)
        reach = (points[..., end, :] - points[..., start, :]) @ along
        moved = jnp.asarray([float(k in carried(mechanism, start)) for k in range(mechanism.num_keypoints)])
        points = points + moved[:, None] * (lean[start] * reach)[..., None, None] * along
    return points.reshape(x.shape)


def beside(mechanism: Mechanism, pivot: Array, offsets: Array, x: Array) -> Array:
    """Move each keypoint at which rods start, with all that hangs on it, by an offset in the part that holds it.

    A keypoint beside a joint, and all after it as far beside theirs, keep every constraint, and no single frame
    objects. What does is a picture of the next part, which such a keypoint makes turn about a point off its joint.

    Args:
        mechanism: the declaration.
        pivot: `[2]`, image units.
        offsets: `[K, 2]` image units: along the rod that ends in the keypoint and to its left, or to the right and up
            if none does.
        x: `[n]` positions.

    Returns:
        `[n]`.
    """
    points, holders = x.reshape(-1, 2), {rod.end: rod for rod in reversed(mechanism.rods)}
    for k in outwards(mechanism):
        if not is_joint(mechanism, k):
            continue
        offset = offsets[k]
        if (rod := holders.get(k)) is not None:
            reach = points[k] - (pivot if rod.start is None else points[rod.start])
            right, up = reach / jnp.sqrt(jnp.sum(reach**2) + 1e-12)
            offset = jnp.stack([offset[0] * right - offset[1] * up, offset[0] * up + offset[1] * right])
        moved = jnp.asarray([float(i in carried(mechanism, k)) for i in range(mechanism.num_keypoints)])
        points = points + moved[:, None] * offset
    return points.reshape(x.shape)


def is_joint(mechanism: Mechanism, keypoint: int) -> bool:
    """Whether a rod starts at a keypoint."""
    return any(rod.start == keypoint for rod in mechanism.rods)


def outwards(mechanism: Mechanism) -> list[int]:
    """All keypoints, those that carry others before these."""
    return sorted(range(mechanism.num_keypoints), key=lambda k: -len(carried(mechanism, k)))


def carried(mechanism: Mechanism, keypoint: int) -> set[int]:
    """A keypoint and all that hangs on it."""
    out, reached = {keypoint}, set[int]()
    while out != reached:
        reached = set(out)
        out |= {rod.end for rod in mechanism.rods if rod.start in out}
    return out
