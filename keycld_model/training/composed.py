"""Poses that no recording has: every part as it was in some frame, put together."""

import numpy as np
from numpy.typing import NDArray

from keycld_envs.mechanism import Mechanism
from keycld_model.places import outwards

BESIDE = 1 / 3
"""Share of the rods that point where another one does: parts that hide each other, or lie in line, are hardest to see,
and rare where motions are independent."""
WITHIN = 0.15
"""Standard deviation of the angle between them, rad."""


def composed(
    mechanism: Mechanism, positions: NDArray[np.float32], pivot: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Put parts together that were seen in different poses.

    What no rod holds is where it was in one of the frames, and each rod points where it did in another, or where a rod
    that was placed before it does. No keypoint is farther to any side than in the frames; what would be is left as it
    was, and so is a mechanism with loops, whose parts cannot turn one by one.

    Args:
        mechanism: the declaration.
        positions: `[B, n]`, image units, to be put together; as many come back.
        pivot: `[2]`, image units.
        rng: chance.

    Returns:
        `[B, n]`.
    """
    held = [rod.end for rod in mechanism.rods] + [slider.keypoint for slider in mechanism.sliders]
    if len(set(held)) < len(held):
        return positions
    count = len(positions)
    seen = positions.reshape(count, -1, 2)
    out, directions = seen.copy(), np.empty((0, count, 2), np.float32)
    holders = {rod.end: rod for rod in mechanism.rods}
    for k in outwards(mechanism):
        if k not in holders:
            continue
        start = holders[k].start
        reach = (seen[:, k] - (pivot if start is None else seen[:, start]))[rng.permutation(count)]
        length = np.linalg.norm(reach, axis=1, keepdims=True) + 1e-9
        direction = reach / length
        if len(directions):
            other = directions[rng.integers(len(directions), size=count), np.arange(count)]
            angle = rng.normal(0.0, WITHIN, count)
            cos, sin = np.cos(angle), np.sin(angle)
            turned = np.stack([cos * other[:, 0] - sin * other[:, 1], sin * other[:, 0] + cos * other[:, 1]], 1)
            direction = np.where(rng.random(count)[:, None] < BESIDE, turned, direction)
        directions = np.concatenate([directions, direction[None]])
        out[:, k] = (pivot if start is None else out[:, start]) + length * direction
    inside = ((out >= seen.min(0)) & (out <= seen.max(0))).all((1, 2))
    return np.where(inside[:, None, None], out, seen).reshape(positions.shape).astype(np.float32)
