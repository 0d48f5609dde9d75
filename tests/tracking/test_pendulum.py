"""The equation of motion, its fit, and what held-out swings say about dissipation."""

import numpy as np
import pytest
from scenes import nothing, swing
from scipy.special import ellipk

from keycld_model.tracking.pendulum import study_pendulum
from keycld_model.tracking.pendulum.motion import Motion
from keycld_model.tracking.pendulum.study import half_swings, released
from keycld_model.tracking.scatter import scatter
from keycld_model.tracking.track import _unwrapped


def test_period_of_large_swings_is_the_elliptic_integral():
    times = np.arange(0, 12, 0.01)
    angles = Motion(()).simulate(np.array([[2 * np.log(2 * np.pi), 0.0, 1.2, 0.0]]), times)[0]
    swings = half_swings(times, angles)
    assert np.allclose(swings[:, 1], 1.2, atol=2e-3)
    assert np.allclose(swings[:, 2], 2 / np.pi * ellipk(np.sin(0.6) ** 2), rtol=1e-3)


def test_scatter_is_the_size_of_white_noise():
    times = np.arange(2000) / 50
    noise = np.random.default_rng(0).normal(0, 0.3, 2000)
    assert abs(scatter(times, 40 * np.sin(2 * times) + noise)[1] / 0.3 - 1) < 0.1


@pytest.mark.long
@pytest.mark.parametrize(
    ("term", "size"), [("viscous_friction", 0.15), ("quadratic_drag", 0.12), ("coulomb_friction", 0.25)]
)
def test_dissipation_is_named(term, size):
    times = np.arange(450) / 30
    angles = swing(times, (term,), (size,)) + np.random.default_rng(1).normal(0, 1e-3, 450)
    study = study_pendulum(times, angles, 0, nothing)
    assert study is not None and study.named == (term,)
    value, low, high, _ = study.parameters[term]
    assert low < value < high and abs(value / size - 1) < 0.1
    assert abs(study.period[0] / 1.2 - 1) < 0.002


def held_and_let_go(held: float, seconds: float = 10.0, start: float = 0.5, period: float = 1.9):
    """A pendulum with viscous friction that is held aside for some seconds, 30 frames a second."""
    times = np.arange(round(seconds * 30)) / 30
    free = Motion(("viscous_friction",)).simulate(
        np.array([[2 * np.log(2 * np.pi / period), 0.0, start, 0.0, 0.15]]), np.concatenate([[0.0], times])
    )[0, 1:]
    wait = round(30 * held)
    angles = np.concatenate([np.full(wait, start), free])[: len(times)]
    return times, angles + np.random.default_rng(3).normal(0, 3e-4, len(times))


@pytest.mark.parametrize("held", [0.0, 0.4, 1.0, 2.5])
@pytest.mark.parametrize("late", [0, 10, 20, 33, 50])
def test_a_free_swing_begins_where_it_is_let_go(held, late):
    times, angles = held_and_let_go(held)
    begin = released(times[late:], angles[late:], 1.9) + late
    assert late <= begin <= max(late, 30 * (held + 0.2))
    if 30 * held > late + 30 * 0.3:  # it is held for .3 s and more of what is seen
        assert begin >= 30 * held


def test_a_pendulum_that_is_held_first_is_timed_after_that():
    study = study_pendulum(*held_and_let_go(2.5), 0, nothing)
    assert study is not None and study.named == ("viscous_friction",)
    assert study.period[1] < 1.9 < study.period[2] and abs(study.period[0] / 1.9 - 1) < 1e-3
    value, low, high, _ = study.parameters["viscous_friction"]
    assert low < 0.15 < high and abs(value / 0.15 - 1) < 0.02
    assert np.isnan(study.prediction[:75]).all() and np.isfinite(study.prediction[80:]).all()


@pytest.mark.long
def test_a_short_noisy_swing_names_nothing():
    times = np.arange(150) / 30
    angles = swing(times, ("viscous_friction",), (0.02,)) + np.random.default_rng(2).normal(0, 2e-2, 150)
    study = study_pendulum(times, angles, 0, nothing)
    assert study is None or study.named in (None, ())


@pytest.mark.parametrize("missing", ["two gaps", "frames at random"])
def test_a_swing_that_lacks_frames_behind_an_even_clock_has_no_period(missing):
    times, kept = np.arange(200) / 30, np.ones(200, bool)
    if missing == "two gaps":
        kept[60:75] = kept[120:140] = False
    else:
        kept[np.random.default_rng(0).choice(200, 57, replace=False)] = False
    angles = (swing(times, ("viscous_friction",), (0.12,)) + np.random.default_rng(1).normal(0, 5e-4, 200))[kept]
    assert study_pendulum(times[: len(angles)], angles, 0, nothing) is None
    study = study_pendulum(times[kept], angles, 0, nothing)  # as they were taken
    assert study is not None and abs(study.period[0] / 1.2 - 1) < 0.002


def test_angles_are_unwrapped_from_frame_to_frame_and_across_gaps():
    times = np.arange(60) / 30
    turning = 12 * times + 0.5 * np.sin(9 * times)
    wrapped = np.angle(np.exp(1j * turning))
    wrapped[20:26] = np.nan
    found = _unwrapped(wrapped, times)
    known = np.isfinite(found)
    assert known.sum() == 54 and np.allclose(found[known], turning[known])


def test_one_wrong_angle_does_not_turn_the_others():
    times, angles = np.arange(40) / 30, np.zeros(40)
    angles[10] = 3.1
    assert np.abs(_unwrapped(angles, times)).max() < 3.2
