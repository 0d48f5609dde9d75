"""What swings or follows faster than recordings show: rotors behind shafts, motors that lag."""

from dataclasses import replace

import numpy as np
import plants
import pytest
from plants import NOISE, problem_of, recordings

from keycld_envs.effects import ActuatorLag, AddedMass, JointFlexibility
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.search.criterion import penalty
from keycld_model.diagnosis.search.explain import explain
from keycld_model.diagnosis.search.transmissions import with_free_rotors
from keycld_model.diagnosis.simulation.simulator import Simulator

GEAR, INERTIA, STEP = 2.0, 0.25, 1e-3
"""Of the pendulum; and s between calls of the plant's forces."""
SHAFT = JointFlexibility("torque", j=0.05, k=30.0, zeta=0.03)


def shaft():
    """The torque of a rotor behind a soft shaft in place of the motor's."""
    rotor = [0.0, 0.0]

    def push(t, q, v, u):
        if t == 0:
            rotor[:] = q[0], v[0]
        twist, slip = rotor[0] - q[0], rotor[1] - v[0]
        torque = SHAFT.k * twist + 2 * SHAFT.zeta * np.sqrt(SHAFT.k * SHAFT.j) * slip
        rotor[1] += STEP * (GEAR * u[0] - torque) / SHAFT.j
        rotor[0] += STEP * rotor[1]
        return np.array([torque - GEAR * u[0]])

    return push


def lag(seconds):
    """The change of the torque of a motor that lags."""
    motor = [0.0]

    def push(t, q, v, u):
        if t == 0:
            motor[0] = u[0]
        before = motor[0]
        motor[0] += (u[0] - motor[0]) * -np.expm1(-STEP / seconds)
        return GEAR * np.array([(before + motor[0]) / 2 - u[0]])

    return push


def pendulum(runs, noise):
    return problem_of(Simulator(get_system("pendulum").compile(), 0.01), runs, noise)


def test_rotors_that_may_jump_are_where_recordings_cannot_say():
    """From speeds that are some tenths of a radian per second off, the rotor is thought to be somewhere else."""
    problem, rng = pendulum(recordings("pendulum", 4, shaft(), errors=0.0, number=3), NOISE), np.random.default_rng(0)
    speeds = tuple(v + rng.normal(0, 0.1, v.shape).cumsum(axis=0) for v in problem.windows.speeds)
    blurred = replace(problem, windows=replace(problem.windows, speeds=speeds))
    held = minimise(blurred, blurred.start().with_effects(SHAFT))
    free = minimise(blurred, with_free_rotors(blurred, held.point))
    assert held.chi_square > 2
    assert 0.8 < free.chi_square < 1.2
    (found,), offsets = free.effects, free.point.variant.window_offsets
    assert isinstance(found, JointFlexibility)
    swings = [e.k * (1 / e.j + 1 / INERTIA) for e in (found, SHAFT)]
    assert np.isclose(*swings, rtol=0.05)
    assert offsets is not None and offsets.shape == (len(blurred.windows), 2)
    assert penalty(free) > penalty(held) + len(blurred.windows)


def test_offsets_go_with_their_rotor_and_their_windows():
    problem = pendulum(recordings("pendulum", 4, shaft(), number=1), NOISE)
    point = problem.start().with_effects(SHAFT).with_free_rotors()
    offsets = np.arange(2.0 * len(problem.windows)).reshape(-1, 2)
    point = point.with_offsets(offsets)
    more = point.with_effects(AddedMass("pole"), replace(SHAFT, k=40.0))
    assert np.array_equal(more.offsets, offsets)
    assert point.with_effects(AddedMass("pole")).variant.window_offsets is None
    assert np.array_equal(point.take(np.array([2, 0])).offsets, offsets[[2, 0]])
    assert point.variant.for_other_recordings().window_offsets is None


@pytest.mark.long
def test_shorter_steps_tell_a_lag_from_a_delay(monkeypatch):
    """Half a step of delay, spread over two steps, looks like a lag; half as long, it does not."""
    monkeypatch.setattr(plants, "NOISE", 1e-4)
    runs = recordings("pendulum", 8, lag(0.005), number=6)
    problem = pendulum(runs, 1e-4)
    found = explain(minimise(problem, problem.start())).best
    (effect,) = found.fit.effects
    assert isinstance(effect, ActuatorLag) and np.isclose(effect.lag, 0.005, rtol=0.1)
    assert problem.simulator.step == 2 * found.fit.problem.simulator.step
