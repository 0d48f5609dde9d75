"""Disturbed cameras: numbers by name, and what they do to images."""

import numpy as np
import pytest

from keycld_envs import InputError, KeyCLDEnv
from keycld_envs.disturbance import Disturbance

IMAGE = np.random.default_rng(0).integers(60, 120, (64, 64, 3)).astype(np.uint8)


def test_numbers_are_read_by_name():
    words = {"shift": "2,-1", "brightness": "1,0.5,0.2", "noise": "3", "jpeg": "80", "zoom": "1.02", "yaw": "-0.02"}
    expected = Disturbance(right=2, up=-1, gain=(1, 0.5, 0.2), noise=3, jpeg=80, zoom=1.02, yaw=-0.02)
    assert Disturbance.parse(words) == expected
    assert Disturbance.parse({"brightness": "0.7", "shift": "2"}) == Disturbance(gain=(0.7, 0.7, 0.7), right=2)


@pytest.mark.parametrize(
    "word", ["colour=2", "noise=a", "noise=-1", "shift=1,2,3", "brightness=1,2", "jpeg=nan", "jpeg=0", "blur="]
)
def test_others_are_refused_by_name(word):
    name, text = word.split("=")
    with pytest.raises(InputError, match=name):
        Disturbance.parse({name: text})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("noise", float("nan")),
        ("zoom", float("nan")),
        ("zoom", 0.0),
        ("blur", -1.0),
        ("noise", -1.0),
        ("right", 1e9),
        ("gain", 0.7),
        ("gain", (1.0, 1.0)),
        ("gain", (1.0, -1.0, 1.0)),
        ("jpeg", 0),
        ("jpeg", 80.5),
    ],
)
def test_what_no_camera_does_is_refused(field, value):
    with pytest.raises(InputError, match=field):
        Disturbance(**{field: value})


def test_light_and_noise_are_what_they_say():
    out = Disturbance(gain=(0.5, 1.0, 1.5), offset=10, noise=4).develop(IMAGE, np.random.default_rng(1))
    off = out - (IMAGE * [0.5, 1.0, 1.5] + 10)
    assert abs(off.mean()) < 0.1
    assert off.std() == pytest.approx(np.sqrt(4**2 + 1 / 12), rel=0.02)  # and rounding


@pytest.mark.render
def test_a_camera_shifts_what_it_sees_by_pixels():
    plain, moved = KeyCLDEnv("acrobot"), KeyCLDEnv("acrobot", disturbance=Disturbance(right=2, up=1))
    (still, _), (seen, _) = plain.reset(seed=3), moved.reset(seed=3)
    plain.close()
    moved.close()
    off = np.abs(seen[:-1, 2:].astype(float) - still[1:, :-2])
    assert off.mean() < 1
    assert np.abs(seen.astype(float) - still).mean() > 2


@pytest.mark.render
def test_noise_depends_on_seed_and_step_and_not_the_motion():
    plain, noisy = KeyCLDEnv("pendulum"), KeyCLDEnv("pendulum", disturbance=Disturbance(noise=5))
    plain.reset(seed=4)
    runs = []
    for _ in range(2):
        first, _ = noisy.reset(seed=4)
        second, *_ = noisy.step(np.zeros(1))
        runs.append((first, second))
    np.testing.assert_array_equal(runs[0], runs[1])
    plain.step(np.zeros(1))
    np.testing.assert_array_equal(plain.data.qpos, noisy.data.qpos)
    still, seen = plain.render_frame().astype(float), runs[0][1]
    assert (seen - still).std() == pytest.approx(5, rel=0.05)
    plain.close()
    noisy.close()
