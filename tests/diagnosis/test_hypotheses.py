"""What each effect would change, to first order."""

import numpy as np
import pytest
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis.fit import Problem
from keycld_model.diagnosis.hypotheses import columns, hypotheses, seen
from keycld_model.diagnosis.simulator import Simulator
from keycld_model.diagnosis.windows import cut

SMOOTH = {"constant_force", "spring", "external_periodic", "cogging", "base_motion", "parameter_drift"}


def test_steps_may_be_longer_than_parts_of_a_window():
    model = get_system("pendulum").compile()
    windows = cut(recordings("pendulum", seed=3, number=2, seconds=1.0), 0.05, 30)
    problem = Problem(Simulator(model, 0.05), windows, np.full(model.nv, 1e-3))
    fit = problem.minimise(problem.start(), 2)
    assert windows.steps < 16
    assert np.isfinite(columns(fit, hypotheses(model, seen(fit.problem.windows)))[1]).all()


@pytest.mark.parametrize("system", ["pendulum", "acrobot"])
def test_the_force_along_the_motion_tells_what_simulations_with_little_of_an_effect_do(system):
    model = get_system(system).compile()
    windows = cut(recordings(system, seed=3, number=3), 0.01, 30)
    problem = Problem(Simulator(model, 0.01), windows, np.full(model.nv, 1e-3))
    fit = problem.minimise(problem.start())
    free = [h for h in hypotheses(model, seen(fit.problem.windows)) if h.effect.id in SMOOTH]
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
