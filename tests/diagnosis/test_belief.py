"""What recordings leave open is open where it is tested on others."""

from dataclasses import replace

import numpy as np
import pytest
from plants import problem_of, recordings

from keycld_envs.effects import ViscousFriction
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.belief import Belief
from keycld_model.diagnosis.estimation.gauss_newton import learned, minimise
from keycld_model.diagnosis.estimation.replay import predict, predicted, replay
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.prepare import split
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant


@pytest.fixture(scope="module")
def runs():
    """One third of them is passive."""
    return recordings("pendulum", 3, errors=0.2, number=12, seconds=2.0)


@pytest.fixture(scope="module")
def passive(runs):
    return runs[::3]


@pytest.fixture(scope="module")
def driven(runs):
    return runs[2:6:3]


def fitted(runs, *effects):
    problem = problem_of(Simulator(get_system("pendulum").compile(), 0.01), runs)
    return minimise(problem, problem.start().with_effects(*effects), 20)


def test_a_driven_recording_mends_what_passive_ones_leave_open(passive, driven):
    fit, other = fitted(passive), fitted(driven).problem
    assert fit.chi_square < 1.3 < replay(other, fit).chi_square
    told = predict(other, fit)
    assert told.chi_square < 1.3
    assert predicted(told) > -replay(replace(other, belief=learned(fit)), fit).cost


def test_what_is_open_helps_no_effect_that_is_not_there(passive, driven):
    other = fitted(driven).problem
    without, spurious = (predicted(predict(other, fitted(passive, *e))) for e in ((), (ViscousFriction("hinge", 0.0),)))
    assert spurious < without + 3.0


def test_a_belief_is_sharpened_by_what_others_tell():
    variant, known = Variant(np.zeros(2)), np.diag([4.0, 0.01])
    belief = Belief.of(variant, known)
    assert belief.cost(Variant(np.array([1.0, 1.0]))) == pytest.approx(0.5 * 4.01)
    assert belief.narrowed(known) == pytest.approx(0.0)
    assert belief.narrowed(known + np.diag([0.0, 0.99])) == pytest.approx(0.5 * np.log(0.01))


def test_the_only_driven_recording_is_learned_from(runs, passive):
    observation = JointPositions(get_system("pendulum").compile())
    for driven in (*runs[1::3], *runs[2::3]):
        training, test = split([*passive[:3], driven, *passive[3:]], observation, 40)
        assert any(r is driven for r in training) and len(test) == 2
    two, one = split([passive[0], driven], observation, 40)
    assert len(two) == len(one) == 1


def test_passive_motion_tells_nothing_of_the_scale_of_all_masses():
    model = get_system("acrobot").compile()
    assert not model.dof_damping.any() and not model.dof_armature.any()
    passive = recordings("acrobot", 5, errors=0.2, number=7, seconds=2.0)[::3]
    problem = problem_of(Simulator(model, 0.01), passive)
    fit = minimise(problem, problem.start(), 20)
    slopes = problem.linearise(fit.point)[0].shared
    masses = [i for i, nuisance in enumerate(problem.nuisances) if nuisance.kind == "mass"]
    one, all_of_them = (float(np.sum(column**2)) for column in (slopes[..., masses[1]], slopes[..., masses].sum(-1)))
    assert one * problem.spreads[masses[1]] ** 2 > 100 > 0.1 > all_of_them * problem.spreads[masses[1]] ** 2


def test_nor_of_the_scale_of_all_masses_and_a_friction_that_explains_much():
    def damped(t, q, v, u):
        return np.array([0.0, -0.5 * v[1]])

    model = get_system("acrobot").compile()
    passive = recordings("acrobot", 5, damped, errors=0.2, number=7, seconds=2.0)[::3]
    problem = problem_of(Simulator(model, 0.01), passive)
    fit = minimise(problem, problem.start().with_effects(ViscousFriction("elbow", 0.5)), 20)
    slopes = problem.linearise(fit.point)[0].shared
    masses = [i for i, nuisance in enumerate(problem.nuisances) if nuisance.kind == "mass"]
    (friction,) = fit.effects
    assert isinstance(friction, ViscousFriction)
    braking = slopes[..., len(problem.nuisances)] * friction.b  # to its logarithm
    together = slopes[..., masses].sum(-1) + braking
    one, all_of_them = (float(np.sum(column**2)) for column in (braking, together))
    assert one > 1e6 > 0.01 > all_of_them * problem.spreads[masses[1]] ** 2
