"""Steps of shared parameters that move initial states far."""

from dataclasses import replace

import numpy as np
import pytest
from plants import NOISE, recordings

from keycld_envs.effects import ConstantForce
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.simulation.simulator import Simulator


def test_errors_by_the_square_of_a_position_do_not_keep_a_force_from_being_found():
    """Where a cart is, no force tells: a camera that is off by .04 q² moves its states by half a metre."""

    def force(t, q, v, u):
        return np.array([0.15, 0.0])

    runs = []
    for run in recordings("cartpole", 3, force, command=lambda u: 0 * u, number=6, errors=0.0):
        q = np.array(run.qpos)
        q[:, 0] += (0.04 - 0.03 * q[:, 0]) * q[:, 0]
        runs.append(replace(run, qpos=q, action=0 * np.asarray(run.action)))
    assert max(np.abs(run.qpos[:, 0]).max() for run in runs) > 1.5
    simulator = Simulator(get_system("cartpole").compile(), 0.01)
    observation = JointPositions(simulator.model, np.full(2, NOISE), tracked=True)
    problem = Problem(simulator, cut(runs, observation, simulator.step, 40))
    refitted = minimise(problem, problem.start(), 15)
    found = minimise(problem, refitted.point.with_effects(ConstantForce("slider", 0.0)), 12)
    assert found.cost < 1.1 * problem.expected < refitted.cost
    (missing,) = found.effects
    assert isinstance(missing, ConstantForce) and missing.f == pytest.approx(0.15, rel=0.15)
