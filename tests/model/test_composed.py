"""Poses that no recording has."""

import numpy as np
import pytest

from keycld_envs import Mechanism, Rod, Slider
from keycld_model.training.composed import composed

CART = Mechanism(3, 3, rods=(Rod(0, 1), Rod(0, 2)), sliders=(Slider(0),))
ARM = Mechanism(2, 2, rods=(Rod(None, 0), Rod(0, 1)))
PIVOT = np.array([0.1, -0.2], np.float32)


def recorded(mechanism, count=400):
    """Poses in which all rods turn together."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(-np.pi, np.pi, count)
    rod = np.stack([np.sin(angle), np.cos(angle)], 1)
    if mechanism is ARM:
        first = PIVOT + 0.4 * rod
        return np.concatenate([first, first + 0.3 * rod], 1).astype(np.float32)
    cart = np.stack([rng.uniform(-0.5, 0.5, count), np.zeros(count)], 1)
    return np.concatenate([cart, cart + 0.4 * rod, cart - 0.2 * rod], 1).astype(np.float32)


def rods(mechanism, positions):
    """`[rods, B, 2]` of positions `[B, n]`."""
    points = positions.reshape(len(positions), -1, 2)
    return np.stack([points[:, r.end] - (PIVOT if r.start is None else points[:, r.start]) for r in mechanism.rods])


@pytest.mark.parametrize("mechanism", [CART, ARM])
def test_rods_keep_their_lengths_and_take_any_angle_to_each_other(mechanism):
    positions = recorded(mechanism)
    found = composed(mechanism, positions, PIVOT, np.random.default_rng(0))
    assert found.shape == positions.shape and found.dtype == np.float32
    before, after = rods(mechanism, positions), rods(mechanism, found)
    np.testing.assert_allclose(
        np.linalg.norm(after, axis=2), np.broadcast_to(np.linalg.norm(before, axis=2), after.shape[:2]), atol=1e-5
    )
    cosines = (after[0] * after[1]).sum(1) / np.prod(np.linalg.norm(after, axis=2), 0)
    assert np.histogram(np.arccos(np.clip(cosines, -1, 1)), 8, (0, np.pi))[0].min() > 0.03 * len(found)
    assert 0.3 < np.mean(cosines > np.cos(0.3)) < 0.6  # a third points where the other rod does


def test_no_keypoint_is_outside_of_what_was_seen():
    positions = recorded(CART)
    found = composed(CART, positions, PIVOT, np.random.default_rng(0))
    assert (found >= positions.min(0)).all() and (found <= positions.max(0)).all()


@pytest.mark.parametrize(
    "loop",
    [
        Mechanism(3, 1, rods=(Rod(None, 0), Rod(0, 2), Rod(1, 2), Rod(None, 1))),
        Mechanism(2, 1, rods=(Rod(None, 0), Rod(0, 1)), sliders=(Slider(1),)),
    ],
)
def test_parts_of_a_loop_are_not_turned(loop):
    positions = np.random.default_rng(0).uniform(-1, 1, (20, 2 * loop.num_keypoints)).astype(np.float32)
    np.testing.assert_array_equal(composed(loop, positions, PIVOT, np.random.default_rng(0)), positions)
