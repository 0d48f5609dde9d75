"""Pushes and their shapes."""

import numpy as np
import plants
import pytest
from plants import problem_of, recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.pulses import with_best_pulses, with_pulses
from keycld_model.diagnosis.search.criterion import above_noise
from keycld_model.diagnosis.search.explain import perhaps_pushed
from keycld_model.diagnosis.search.residual_fit import fit_residual_force, freedom, residual_force_of
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Pulse


def bump(t, q, v, u):
    """Half a sine, across the border of two windows."""
    return np.array([0.5 * np.sin(np.pi * (t - 1.0) / 0.4) * (1.0 <= t < 1.4)])


def box(t, q, v, u):
    return np.array([-0.5 * (0.85 <= t < 1.1)])


@pytest.fixture(autouse=True)
def good_sensors(monkeypatch):
    monkeypatch.setattr(plants, "NOISE", 2e-4)


def pushes(force):
    runs = recordings("pendulum", 9, force, errors=0.0, number=3, seconds=4.0)
    simulator = Simulator(get_system("pendulum").compile(), 0.01)
    problem = problem_of(simulator, runs, 2e-4)
    fit = with_pulses(minimise(problem, problem.start()))
    assert fit.chi_square < 1.5
    return fit.point.variant.pulses


def test_a_bump_across_windows_is_one_half_sine():
    found = pushes(bump)
    assert len(found) == 3 and all(p.rounded for p in found)
    for p in found:
        assert abs(p.start - 1.0) < 0.05 and abs(p.start + p.duration - 1.4) < 0.05
        assert np.isclose(p.force, 0.5, rtol=0.1)


def test_a_box_stays_a_rectangle():
    found = pushes(box)
    assert len(found) == 3 and not any(p.rounded for p in found)
    assert all(abs(p.start - 0.85) < 0.02 and abs(p.duration - 0.25) < 0.03 for p in found)


def three_strong(t, q, v, u):
    """So strong that masses make up for them, which are then wrong in the windows between."""
    return np.array([4.0 * sum((-1) ** k * ((1.3 * k + 0.45) <= t < (1.3 * k + 0.65)) for k in range(3)), 0.0])


def fades_with_speed(t, q, v, u):
    """Strong friction that is least where the pendulum is fast, so that some windows leave far more than others."""
    return -0.25 * v / (1 + (v / 2.1) ** 2)


@pytest.mark.parametrize(
    ("system", "force", "pushed"), [("acrobot", three_strong, True), ("pendulum", fades_with_speed, False)]
)
def test_pushes_that_seem_to_be_in_most_windows_are_found_where_they_are_and_what_is_everywhere_is_none(
    monkeypatch, system, force, pushed
):
    monkeypatch.setattr(plants, "NOISE", 1e-3)
    runs = recordings(system, 9, force, errors=0.0, number=6, seconds=4.0)
    problem = problem_of(Simulator(get_system(system).compile(), 0.01), runs, 1e-3)
    refitted = minimise(problem, problem.start(), 15)
    fit = with_pulses(refitted, [0])
    assert bool(fit.point.variant.pulses) == pushed
    assert (fit.excess < 0.01 * refitted.excess) == pushed
    impulses = [(p.start, abs(p.force * p.duration)) for p in fit.point.variant.pulses]
    there = sum(size for start, size in impulses if min(abs(start - t) for t in (0.45, 1.75, 3.05)) < 0.25)
    assert there >= 0.9 * sum(size for _, size in impulses)


def now_and_then(t, q, v, u):
    """Weak, at other times in every run than where the pendulum is in the same state."""
    return np.array([0.12 * (0.7 <= t < 1.0) - 0.12 * (2.9 <= t < 3.2)])


def drag(t, q, v, u):
    return 0.012 * v * np.abs(v)


@pytest.mark.parametrize(("force", "pushed"), [(now_and_then, True), (drag, False)])
def test_pushes_are_tried_unless_a_force_that_depends_on_the_state_takes_fewer_numbers(monkeypatch, force, pushed):
    monkeypatch.setattr(plants, "NOISE", 4e-3)  # so much that such a force leaves only noise, either way
    runs = recordings("pendulum", 9, force, errors=0.0, number=4, seconds=4.0)
    problem = problem_of(Simulator(get_system("pendulum").compile(), 0.01), runs, 4e-3)
    refitted = minimise(problem, problem.start())
    residual = fit_residual_force(refitted)
    likely = with_best_pulses(refitted)
    found = residual_force_of(residual)
    assert found is not None and 1 < freedom(residual) < found.weights.size / 2
    assert above_noise(residual).max() < 0
    assert perhaps_pushed(likely, refitted, residual) == pushed


def test_impulses_are_integrals():
    t = np.linspace(0.0, 1.0, 2001)
    for rounded, mean in ((False, 1.0), (True, 2 / np.pi)):
        pulse = Pulse(0, 0, 0.25, 0.5, 2.0, rounded)
        assert np.isclose(pulse.impulse(t)[-1], 2.0 * 0.5 * mean)
        force = np.gradient(pulse.impulse(t), t)
        assert np.isclose(force.max(), 2.0, rtol=1e-3) and force[t < 0.24].max() == 0
