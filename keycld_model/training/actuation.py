"""Forces of motors that act at joints: couples on rods, and forces along rails."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.mechanism import Mechanism

Vector = NDArray[np.float64]
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Counterclockwise; a rod turned by it is the direction in which its end moves."""


def joint_forces(mechanism: Mechanism, pivot: ArrayLike) -> tuple[Vector, Vector]:
    """Forces at keypoints that do constant work per radian of a rod, or per image unit of a rail.

    A motor between two rods is one couple on each, in opposite directions; one between a carriage and a rod is a
    couple on the rod, for the carriage cannot turn. A couple on a rod is a pair of opposite forces at its ends, across
    it; a pivot bears the one at its end.

    Args:
        mechanism: the declaration, of c rods and sliders.
        pivot: `[2]`, image units.

    Returns:
        `[c, n, n]` and `[c, n]`: at keypoints `[n]` x, joint j acts with the forces `x @ linear[j] + constant[j]`.
    """
    keypoints = np.eye(mechanism.num_keypoints)
    linear, constant = [], []
    for rod in mechanism.rods:
        along = keypoints[rod.end] - (0 if rod.start is None else keypoints[rod.start])
        linear.append(np.kron(np.outer(along, along), QUARTER_TURN.T))
        held = np.asarray(pivot, float) if rod.start is None else np.zeros(2)
        constant.append(-np.kron(along, QUARTER_TURN @ held))
    for slider in mechanism.sliders:
        linear.append(np.zeros_like(np.kron(keypoints, QUARTER_TURN)))
        constant.append(np.kron(keypoints[slider.keypoint], slider.along))
    return np.array(linear), np.array(constant)
