"""Recordings in pieces, and what effects remember of a recording before a piece begins."""

import numpy as np
import pytest
from plants import recordings

from keycld_envs.effects import HystereticFriction, JointFlexibility
from keycld_model.diagnosis.acting import memories
from keycld_model.diagnosis.windows import cut


@pytest.fixture(scope="module")
def runs():
    return recordings("cartpole", seed=1, number=2)


def test_windows_start_at_a_step_before_their_first_sample(runs):
    windows = cut(runs, 0.004, 40)
    lead = windows.time[:, 0] - windows.start
    assert (lead > -1e-9).all() and (lead < 0.004 + 1e-9).all() and (windows.end >= windows.time[:, -1]).all()
    np.testing.assert_allclose(windows.start, windows.first * 0.004, atol=1e-9)
    assert windows.edges(7)[[0, -1]].tolist() == [0, windows.steps]


def test_shorter_windows_hold_the_same_samples(runs):
    windows = cut(runs, 0.004, 40)
    short = windows.shorter(4)
    assert short.time.shape == (4 * len(windows), 10)
    order = np.lexsort((short.time[:, 0], short.recording))
    for name in ("time", "measured"):
        whole = np.concatenate(getattr(windows, name))
        np.testing.assert_array_equal(np.concatenate(getattr(short, name)[order]), whole)
    lead = short.time[:, 0] - short.start
    assert (lead > -1e-9).all() and (lead < 0.004 + 1e-9).all() and (short.end >= short.time[:, -1]).all()
    np.testing.assert_allclose(short.start, short.first * 0.004, atol=1e-9)


def test_speeds_are_those_of_the_motion(runs):
    windows = cut(runs, 0.01, 40)
    for run, speeds in zip(runs, windows.speeds, strict=True):
        t, q = np.asarray(run.t_state), np.asarray(run.qpos)
        times = t[0] + 0.01 * (np.arange(len(speeds)) + 0.5)
        true = np.stack(
            [np.interp(times, (t[1:] + t[:-1]) / 2, np.diff(column) / np.diff(t)) for column in q.T], axis=1
        )
        inside = (times > t[3]) & (times < t[-4])
        assert np.sqrt(np.mean((speeds - true)[inside] ** 2)) < 0.2  # differences have noise of .14 rad/s or m/s


def test_a_shaft_remembers_how_it_was_twisted():
    soft, stiff = JointFlexibility("m", j=0.01, k=5.0), JointFlexibility("m", j=0.01, k=20.0)
    motor, speed = np.full((3000, 2, 1), 0.4), np.full((3000, 1), 1.5)
    path = memories([soft, stiff], motor, speed, 0.005)
    assert path.shape == (3001, 2, 1, 2)
    np.testing.assert_allclose(path[-1, :, 0, 0], [0.4 / 5, 0.4 / 20], rtol=1e-3)
    np.testing.assert_allclose(path[-1, :, 0, 1], 1.5, rtol=1e-3)


def test_bristles_remember_how_they_were_bent():
    friction = HystereticFriction("hinge", c=0.2, extra=0.1, s=10.0, vs=0.5)
    speed = np.concatenate([np.full(500, -2.0), np.full(2, 0.01)])[:, None]
    path = memories([friction], np.zeros((502, 1, 1)), speed, 0.01)[:, 0, 0, 0]
    assert path[500] == pytest.approx(-0.02, rel=1e-3)  # slips at c
    assert -0.02 < path[502] < -0.0195  # hardly moved since
