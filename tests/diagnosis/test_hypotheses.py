"""What each effect would change, to first order."""

from dataclasses import replace

import numpy as np
import pytest
from plants import problem_of, recordings, windows_of

from keycld_envs.effects import ActuatorSaturation, EndStop
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.search.hypotheses import columns, hypotheses, recorded_range
from keycld_model.diagnosis.simulation.simulator import Simulator

SMOOTH = {"constant_force", "spring", "external_periodic", "cogging", "base_motion", "parameter_drift"}


def test_steps_may_be_longer_than_parts_of_a_window():
    model = get_system("pendulum").compile()
    problem = problem_of(Simulator(model, 0.05), recordings("pendulum", seed=3, number=2, seconds=1.0), samples=30)
    fit = minimise(problem, problem.start(), 2)
    assert problem.windows.steps < 16
    assert np.isfinite(columns(fit, hypotheses(model, recorded_range(fit.problem.windows)))[1]).all()


@pytest.mark.long
@pytest.mark.parametrize("system", ["pendulum", "acrobot"])
def test_the_force_along_the_motion_tells_what_simulations_with_little_of_an_effect_do(system):
    model = get_system(system).compile()
    problem = problem_of(Simulator(model, 0.01), recordings(system, seed=3, number=3), samples=30)
    fit = minimise(problem, problem.start())
    free = [h for h in hypotheses(model, recorded_range(fit.problem.windows)) if h.effect.id in SMOOTH]
    linear, predicted, members = columns(fit, free)
    assert {h.effect.id for h in free if h.pushes} == SMOOTH
    for hypothesis, own in zip(free, members, strict=True):
        amount = 1e-2
        probes = [(probe,) for probe in hypothesis.probes(amount)]
        _, moved = problem.linearise(fit.point, probes)
        for c, residual, number in zip(own, moved, hypothesis.coefficients, strict=True):
            simulated = linear.project((linear.residual - residual)[..., None] / (amount * number.scale))[..., 0]
            column = linear.project(predicted[..., c, None])[..., 0]
            assert np.linalg.norm(column - simulated) < 0.1 * np.linalg.norm(simulated), hypothesis.effect


def test_searches_start_within_what_recordings_show():
    """Limits of motors among the commands, stops where the joint was."""
    model = get_system("cartpole").compile()
    windows = windows_of(recordings("cartpole", 0, number=3, seconds=1.0), model, samples=20)
    shown = recorded_range(windows)
    small = replace(windows, commands=tuple(0.01 * u for u in windows.commands))
    for scale, where in ((1.0, shown), (0.01, recorded_range(small))):
        limits = [h.effect for h in hypotheses(model, where) if isinstance(h.effect, ActuatorSaturation)]
        most = max(np.abs(u).max() for u in windows.commands) * scale
        assert len(limits) == 12 and all(0.05 * most < effect.s < most for effect in limits)
    stops = [h.effect for h in hypotheses(model, shown) if isinstance(h.effect, EndStop)]
    for joint, name in enumerate(("slider", "hinge_1")):
        here, q = [e for e in stops if e.where == name], windows.measured[..., joint]
        assert len(here) == 12 and all(q.min() < e.at < q.max() for e in here)
        assert min(e.at for e in here if e.side > 0) > min(e.at for e in here if e.side < 0)
