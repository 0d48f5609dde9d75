"""Joint angles and slider positions that keypoints show, and how well they agree with measured ones."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from keycld_envs.mechanism import Mechanism

Floats = NDArray[np.floating]


def joint_angles(mechanism: Mechanism, keypoints: Floats) -> Floats:
    """Angle of every rod, clockwise from straight up, relative to the rod that it hangs on if there is one.

    Args:
        mechanism: the declaration.
        keypoints: [..., K, 2], image units.

    Returns:
        [..., R] rad, one per rod, in the order of declaration.
    """
    absolute = []
    for rod in mechanism.rods:
        start = np.asarray(mechanism.pivot) if rod.start is None else keypoints[..., rod.start, :]
        along = keypoints[..., rod.end, :] - start
        absolute.append(np.arctan2(along[..., 0], along[..., 1]))
    ends = [rod.end for rod in mechanism.rods]
    relative = [
        angle - absolute[ends.index(rod.start)] if rod.start in ends else angle
        for rod, angle in zip(mechanism.rods, absolute, strict=True)
    ]
    return wrap(np.stack(relative, axis=-1)) if relative else np.empty((*keypoints.shape[:-2], 0))


def matched(mechanism: Mechanism, angles: Floats, true: Floats) -> Floats:
    """Angles of rods in the order of the hinges that they go with.

    Nothing tells in training which keypoint follows which of several rods that start in the same place, if nothing
    hangs on them; they go with the hinges that fit best. All others are in the order of declaration.

    Args:
        mechanism: the declaration.
        angles: [..., R] rad, one per rod.
        true: [..., R] rad, of the hinges.

    Returns:
        [..., R] rad.
    """
    starts, order = {rod.start for rod in mechanism.rods}, np.arange(angles.shape[-1])
    last = [(i, rod.start) for i, rod in enumerate(mechanism.rods) if rod.end not in starts]
    for start in dict.fromkeys(start for _, start in last):
        group = [i for i, place in last if place == start]
        scores = [[circular_r2(angles[..., rod], true[..., hinge]) for rod in group] for hinge in group]
        order[group] = np.asarray(group)[linear_sum_assignment(scores, maximize=True)[1]]
    return angles[..., order]


def slider_positions(mechanism: Mechanism, keypoints: Floats) -> Floats:
    """Position of every slider along its rail, [..., S] image units, in the order of declaration."""
    positions = [
        (keypoints[..., s.keypoint, :] - np.asarray(mechanism.pivot)) @ np.array([s.normal[1], -s.normal[0]])
        for s in mechanism.sliders
    ]
    return np.stack(positions, axis=-1) if positions else np.empty((*keypoints.shape[:-2], 0))


def joint_positions(mechanism: Mechanism, kinds: Sequence[str], keypoints: Floats, true: Floats) -> Floats:
    """Positions of joints that keypoints show, in the joints' own coordinates.

    A keypoint may sit anywhere on its link and a joint may count the other way round, so that of each hinge one offset
    and the sense, of each slide an offset and the scale are fitted to true positions of the first frames.

    Args:
        mechanism: the declaration; hinges go with its rods and slides with its sliders, each in order.
        kinds: "hinge" or "slide", of every joint.
        keypoints: [N, T, K, 2], image units.
        true: [N, C, nq] rad or m, of the first C frames.

    Returns:
        [N, T, nq] rad, unwrapped over time, or m.
    """
    angles, slides = joint_angles(mechanism, keypoints), slider_positions(mechanism, keypoints)
    count, out, first = {"hinge": 0, "slide": 0}, [], slice(0, true.shape[1])
    for j, kind in enumerate(kinds):
        index, target = count[kind], true[..., j]
        count[kind] += 1
        if kind == "slide":
            line = np.polyfit(slides[:, first, index].ravel(), target.ravel(), 1)
            out.append(np.polyval(line, slides[..., index]))
            continue
        decoded = np.unwrap(angles[..., index], axis=1)
        fits = []
        for sense in (1.0, -1.0):
            difference = wrap(target - sense * decoded[:, first])
            offset = circular_mean(difference)
            fits.append((float(np.mean(wrap(difference - offset) ** 2)), sense, offset))
        _, sense, offset = min(fits)
        out.append(sense * decoded + offset)
    return np.stack(out, axis=-1)


def circular_r2(decoded: Floats, true: Floats) -> float:
    """Share of the circular spread of `true` angles that `decoded` ones explain; 1 is perfect.

    A keypoint may sit anywhere on its link and a joint may count the other way round, so one constant offset and the
    sense of rotation are free.

    Args:
        decoded: angles, rad.
        true: angles of the same shape, rad.
    """
    spread = np.sum(wrap(true - circular_mean(true)) ** 2)
    best = -np.inf
    for sense in (1.0, -1.0):
        error = wrap(sense * decoded - true)
        error = wrap(error - circular_mean(error))
        best = max(best, 1.0 - float(np.sum(error**2) / spread))
    return best


def linear_r2(decoded: Floats, true: Floats) -> float:
    """Squared correlation: offset and scale of the rail are free."""
    return float(np.corrcoef(decoded.ravel(), true.ravel())[0, 1] ** 2)


def circular_mean(angles: Floats) -> float:
    """Direction of the mean unit vector, rad."""
    return float(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))


def wrap(angles: Floats) -> Floats:
    """Into [-pi, pi)."""
    return (angles + np.pi) % (2 * np.pi) - np.pi
