"""Positions read off images of a camera that looks askew, and whose shutter rolls."""

from dataclasses import replace

import numpy as np
import pytest
from plants import NOISE, recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.replay import mean_square
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.observation.encoders_and_camera import EncodersAndCamera
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.search.criterion import above_noise, left_of_noise
from keycld_model.diagnosis.simulation.simulator import Simulator


def filmed(runs, squash: float, skew: float, shutter: float):
    """The same recordings as a camera sees them."""
    out = []
    for run in runs:
        q, t = np.asarray(run.qpos), np.asarray(run.t_state)
        speed = np.gradient(q, t, axis=0)
        seen = q + squash * np.sin(2 * q) + skew * (np.cos(2 * q) - 1) + shutter * speed * np.sin(q)
        out.append(replace(run, qpos=seen))
    return out


@pytest.mark.long
def test_errors_of_a_camera_are_no_missing_physics():
    runs = filmed(recordings("pendulum", 3, number=4, seconds=2.0), 0.03, -0.02, 0.008)
    model = get_system("pendulum").compile()
    report = diagnose(runs, model, tracked=True)
    assert report.verdict == "no_mismatch"
    errors = {name: report.nuisance[f"{name} of hinge"] for name in ("squash", "skew", "shutter")}
    assert [e.value for e in errors.values()] == pytest.approx([0.03, -0.02, 0.008], abs=0.003)
    assert [e.unit for e in errors.values()] == ["rad", "rad", "s"]
    assert diagnose(runs, model).verdict != "no_mismatch"


def test_noise_of_a_camera_is_a_bound_and_that_of_encoders_is_not():
    model = get_system("acrobot").compile()
    said, share = np.array([0.004, 0.002]), np.array([0.25, 1.5])
    seen = JointPositions(model, said, tracked=True, typical=said)
    assert seen.as_left(share).noise == pytest.approx([0.002, 0.002])
    assert seen.as_left(share).noise_at_most == pytest.approx(said)
    assert seen.as_left(np.array([1.0, 1.5])) is seen
    encoders = JointPositions(model, said)
    assert encoders.as_left(share) is encoders
    both = EncodersAndCamera(model, said, np.array([0.001, 0.001, 0.004, 0.002]))
    assert both.as_left(np.concatenate([share, share])).noise == pytest.approx([0.001, 0.001, 0.002, 0.002])
    assert both.as_left(np.array([0.1, 0.1, 1.0, 1.0])) is both
    assert both.as_left(np.concatenate([share, share])).noise_at_most == pytest.approx(both.noise)


def test_misfit_is_more_than_noise_if_it_is_more_than_the_bound():
    model, runs = get_system("pendulum").compile(), recordings("pendulum", 0, number=2, seconds=2.0)
    for said, more in ((NOISE / 2, True), (2 * NOISE, False)):
        seen = JointPositions(model, np.array([said]), typical=np.array([said]))
        quiet = seen.as_left(np.array([(NOISE / 2 / said) ** 2]))  # as other recordings left
        problem = Problem(Simulator(model, 0.01), cut(runs, quiet, 0.01, 40))
        fit = minimise(problem, problem.start())
        assert mean_square(fit) == pytest.approx([4.0], rel=0.3)
        assert left_of_noise(fit) == pytest.approx([(NOISE / said) ** 2], rel=0.3)
        assert bool(above_noise(fit).max() > 0) is more


@pytest.mark.long
@pytest.mark.parametrize("friction, found", [(0.01, ["viscous_friction"]), (0.0, [])])
def test_noise_that_is_said_too_large_hides_nothing(friction, found):
    """Frames drawn again have four times the noise that positions have: what the simulator leaves tells."""
    runs = recordings("pendulum", 5, lambda t, q, v, u: -friction * v, number=6, seconds=2.0)
    model, said = get_system("pendulum").compile(), np.array([4 * NOISE])
    report = diagnose(runs, model, observation=JointPositions(model, tracked=True, floor=said, typical=said))
    assert [finding.effect for finding in report.findings] == found
    assert report.details["noise"] == pytest.approx([NOISE], rel=0.2)
    plain = diagnose(runs, model, observation=JointPositions(model, tracked=True, floor=said))
    assert plain.verdict == "no_mismatch" and plain.details["noise"] == pytest.approx(said)
