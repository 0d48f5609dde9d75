"""Clocks that are late, that drift, and that count from another time."""

from dataclasses import replace

import numpy as np
import pytest
from plants import problem_of, recordings, windows_of

from keycld_envs.effects import ActuatorDelay, ClockDrift, ExternalPeriodic, FrictionDrift, GainDrift, SensorLatency
from keycld_envs.systems import get_system
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant


def simulated(runs, *effects, start=None, samples=40):
    simulator = Simulator(get_system("pendulum").compile(), 0.01)
    problem = problem_of(simulator, runs, samples=samples)
    states = [x[None] for x in start or problem.windows.initial_states()]
    variant = Variant(np.zeros(len(problem.nuisances)), effects)
    return problem.windows, problem.predict([variant], np.zeros(1, int), *states)[0]


@pytest.fixture(scope="module")
def runs():
    return recordings("pendulum", seed=1, number=2)


def test_drifts_and_phases_count_from_the_start_of_a_recording(runs):
    effects = FrictionDrift("hinge", r=0.05), GainDrift("torque", r=0.2), ExternalPeriodic("hinge", a=0.1, b=0.05, w=5)
    later = [replace(r, t_state=r.t_state + 1.7e9, t_action=r.t_action + 1.7e9) for r in runs]
    start = windows_of(runs, get_system("pendulum").compile()).initial_states()
    _, early = simulated(runs, *effects, start=start)
    _, late = simulated(later, *effects, start=start)
    np.testing.assert_allclose(late, early, atol=1e-5)  # clocks of that age tell 2e-7 s


def test_late_positions_of_one_motor_are_positions_of_a_late_motor(runs):
    start = windows_of(runs, get_system("pendulum").compile()).initial_states()
    _, sensor = simulated(runs, SensorLatency(d=0.033), start=start)
    _, motor = simulated(runs, ActuatorDelay("torque", d=0.033), start=start)
    np.testing.assert_allclose(sensor, motor, atol=1e-12)


def test_a_clock_that_drifts_shows_the_same_motion_at_other_times(runs):
    whole, plain = simulated(runs, samples=120)
    _, drifting = simulated(runs, ClockDrift(epsilon=0.02), samples=120)
    for w in np.flatnonzero(whole.first == 0):
        row, true, shown = whole.time[w] - whole.start[w], plain[w, :, 0], drifting[w, :, 0]
        inside = row * 1.02 < row[-1]
        expected = np.interp(row[inside] * 1.02, row, true)
        np.testing.assert_allclose(shown[inside], expected, atol=2e-3)


def test_windows_of_a_drifting_clock_get_the_commands_of_their_own_time(runs):
    """Windows of the middle of a recording agree with the motion that a rollout from its start shows there."""
    whole, shown = simulated(runs, ClockDrift(epsilon=0.02), samples=120)
    simulator = Simulator(get_system("pendulum").compile(), 0.01)
    path, speed, _ = simulator.roll(
        [Variant(np.zeros(len(simulator.nuisances)))],
        np.zeros(1, int),
        whole,
        *(x[None] for x in whole.initial_states()),
    )
    windows = windows_of(runs, simulator.model)
    at = np.flatnonzero(windows.first == 40)
    from_start = np.flatnonzero(whole.first == 0)
    q, v = windows.initial_states()
    for r, w in zip(from_start, at, strict=True):
        step = windows.begun[w] * 1.02 / 0.01
        q[w] = np.interp(step, np.arange(path.shape[2]), path[0, r, :, 0])
        v[w] = np.interp(step, np.arange(path.shape[2]), speed[0, r, :, 0])
    _, pieces = simulated(runs, ClockDrift(epsilon=0.02), start=(q, v))
    for r, w in zip(from_start, at, strict=True):
        np.testing.assert_allclose(pieces[w, :, 0], shown[r, 40:80, 0], atol=5e-3)
