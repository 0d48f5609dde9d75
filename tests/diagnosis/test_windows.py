"""Recordings in pieces, and what effects remember of a recording before a piece begins."""

from dataclasses import replace

import numpy as np
import pytest
from plants import problem_of, recordings, windows_of

from keycld_envs.effects import HystereticFriction, JointFlexibility
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.replay import replay
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.rigid_body.effects import memories


@pytest.fixture(scope="module")
def runs():
    return recordings("cartpole", seed=1, number=2)


@pytest.fixture(scope="module")
def model():
    return get_system("cartpole").compile()


def test_windows_start_at_a_step_before_their_first_sample(runs, model):
    windows = windows_of(runs, model, 0.004)
    lead = windows.time[:, 0] - windows.start
    assert (lead > -1e-9).all() and (lead < 0.004 + 1e-9).all() and (windows.end >= windows.time[:, -1]).all()
    np.testing.assert_allclose(windows.start, windows.first * 0.004, atol=1e-9)
    assert windows.edges(7)[[0, -1]].tolist() == [0, windows.steps]


def test_shorter_windows_hold_the_same_samples(runs, model):
    windows = windows_of(runs, model, 0.004)
    short = windows.shorter(4)
    assert short.time.shape == (4 * len(windows), 10)
    order = np.lexsort((short.time[:, 0], short.recording))
    for name in ("time", "measured"):
        whole = np.concatenate(getattr(windows, name))
        np.testing.assert_array_equal(np.concatenate(getattr(short, name)[order]), whole)
    lead = short.time[:, 0] - short.start
    assert (lead > -1e-9).all() and (lead < 0.004 + 1e-9).all() and (short.end >= short.time[:, -1]).all()
    np.testing.assert_allclose(short.start, short.first * 0.004, atol=1e-9)


def test_windows_begin_after_a_gap_not_in_it(runs, model):
    qpos = np.array(runs[0].qpos)
    qpos[38:58] = np.nan  # the cart has left the image
    qpos[118:138] = np.nan
    windows = windows_of([replace(runs[0], qpos=qpos)], model)
    assert np.isfinite(windows.measured[:, 0]).all()
    q, v = windows.initial_states()
    whole = windows_of([runs[0]], model)
    t, there = np.asarray(runs[0].t_state), np.asarray(runs[0].qpos)
    expected = np.stack([np.interp(windows.start, t, column) for column in there.T], axis=1)
    np.testing.assert_allclose(q, expected, atol=0.03)
    assert np.abs(v).max() < 1.5 * np.abs(whole.speeds[0]).max()


def test_speeds_are_those_of_the_motion(runs, model):
    windows = windows_of(runs, model)
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
    path = memories([soft, stiff], motor, speed, np.zeros((2, motor.shape[2], 2)), 0.005)
    assert path.shape == (3001, 2, 1, 2)
    np.testing.assert_allclose(path[-1, :, 0, 0], [0.4 / 5, 0.4 / 20], rtol=1e-3)
    np.testing.assert_allclose(path[-1, :, 0, 1], 1.5, rtol=1e-3)


def test_bristles_remember_how_they_were_bent():
    friction = HystereticFriction("hinge", c=0.2, extra=0.1, s=10.0, vs=0.5)
    speed = np.concatenate([np.full(500, -2.0), np.full(2, 0.01)])[:, None]
    path = memories([friction], np.zeros((502, 1, 1)), speed, np.zeros((1, 1, 1)), 0.01)[:, 0, 0, 0]
    assert path[500] == pytest.approx(-0.02, rel=1e-3)  # slips at c
    assert -0.02 < path[502] < -0.0195  # hardly moved since


def test_what_a_shaft_does_at_the_start_of_a_recording_is_fitted():
    """A rotor that rings when the recording starts is not taken for another shaft, nor for pushes."""
    simulator, shaft = Simulator(get_system("pendulum").compile(), 0.01), JointFlexibility("torque", j=0.05, k=20.0)
    runs = recordings("pendulum", 6, number=4, seconds=1.7)
    problem = problem_of(simulator, runs)
    truth = problem.start().with_effects(shaft)
    ringing = np.random.default_rng(0).normal(size=(4, 2)) * shaft.memory_spread
    ringing_too = replace(truth, variant=replace(truth.variant, recording_offsets=ringing))
    measured = problem.predicted(ringing_too)
    measured += np.random.default_rng(1).normal(0, 1e-3, measured.shape)
    problem = replace(problem, windows=replace(problem.windows, measured=measured))
    fit = minimise(problem, problem.start().with_effects(replace(shaft, j=0.03, k=15.0)), 40)
    assert fit.chi_square < 1.15
    found = fit.effects[0]
    assert isinstance(found, JointFlexibility)
    assert (found.k / found.j) ** 0.5 == pytest.approx(20, rel=0.05)
    assert fit.deviations().shape == (3,)
    assert (
        np.abs(np.asarray(fit.point.variant.recording_offsets) - ringing) < 0.35 * np.array(shaft.memory_spread)
    ).all()
    again = replay(problem, fit)  # of other recordings, too, only what the shaft does at their start is fitted
    assert again.effects == fit.effects and again.chi_square < 1.15
