"""Whole turns of hinges, which cameras cannot count."""

from dataclasses import replace

import numpy as np
import pytest
from plants import recordings

from keycld_model.diagnosis.inputs.observation.encoders_and_camera import joined
from keycld_model.turns import on_common_turns, on_turns_of

HINGE, SLIDE = np.array([True]), np.array([False])


def swing(start: float, middle: float = np.pi) -> np.ndarray:
    """From rest about where a pendulum hangs."""
    return (middle + (start - middle) * np.cos(np.linspace(0, 12, 200)))[:, None]


def test_what_swings_about_half_a_turn_is_on_one_side_in_all_recordings():
    true = [swing(2.4), swing(3.6), swing(4.0), swing(2.9)]
    read = [q - 2 * np.pi * (q[0] > np.pi) for q in true]
    assert read[1][0] < 0  # as a single image shows it
    for q, right in zip(on_common_turns(read, HINGE), true, strict=True):
        assert q == pytest.approx(right)


def test_what_swings_about_zero_stays_there_and_goes_over_the_top():
    still, over = swing(1.0, 0.0), np.linspace(-0.5, 9.0, 200)[:, None]
    for q, right in zip(on_common_turns([still + 2 * np.pi, over], HINGE), [still, over], strict=True):
        assert q == pytest.approx(right)


def test_slides_and_joints_with_limits_have_no_turns():
    read = [np.full((5, 1), 7.0), np.zeros((5, 1))]
    assert all(np.array_equal(q, r) for q, r in zip(on_common_turns(read, SLIDE), read, strict=True))


def test_frames_that_tell_nothing_are_passed_over():
    q = swing(3.6) - 2 * np.pi
    q[:7] = np.nan
    (out, _) = on_common_turns([q, swing(2.4)], HINGE)
    assert np.isnan(out[:7]).all()
    assert out[7:] == pytest.approx(swing(3.6)[7:])
    nothing = np.full((4, 1), np.nan)
    assert np.isnan(on_common_turns([nothing], HINGE)[0]).all()
    assert on_turns_of(np.full((1, 1), np.nan), q, HINGE) is q


def test_a_camera_beside_encoders_counts_turns_as_they_do():
    (run,) = recordings("pendulum", 1, number=1, seconds=2.0)
    assert run.qpos is not None
    own = np.full(run.qpos.shape, 1e-3)
    camera = replace(run, qpos=run.qpos - 4 * np.pi, qpos_std=own, units={**run.units, "qpos": ("rad",)})
    both = joined(run, camera)
    assert both.qpos is not None and both.qpos_std is None
    assert both.qpos[:, 1] == pytest.approx(both.qpos[:, 0])
