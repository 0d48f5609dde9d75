"""Errors of a camera that was fitted: how well it is known, and what that does to positions."""

import numpy as np
import pytest

from keycld_envs.systems import get_system
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.image_alignment.fit_look import design_effect
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.look import look_parameters
from keycld_model.image_alignment.look_errors import Change, LookErrors, change_by_look
from keycld_model.image_alignment.pose import align
from keycld_model.image_alignment.scene import Scene


@pytest.mark.render
@pytest.mark.parametrize(("name", "amount"), [("right", 0.5), ("aspect", 0.02), ("roll", 0.01)])
def test_a_wrong_camera_reads_positions_that_are_off_as_was_told(name, amount):
    read, told = [], []
    with Scene(get_system("pendulum").compile(), "fixed", (64, 64), "fast") as scene:
        off = np.array([amount if parameter.name == name else 0.0 for parameter in scene.parameters])
        for q in np.linspace(-2.9, 2.9, 12)[:, None]:
            frame, still = scene.render(q, off), scene.render(q - 2, off)
            pose = align(scene, scene.nominal, Light.unchanged(), frame, still, q, near=True)
            read.append((pose.q - q)[0])
            told.append(-(change_by_look(scene, scene.nominal, q).of_look @ off)[0])  # the look is what is too small
    assert np.sqrt(np.mean(np.square(told))) > 5e-3
    assert np.dot(read, told) / np.dot(told, told) == pytest.approx(1, abs=0.35)  # edges that are far off count less
    assert np.linalg.norm(np.subtract(read, told)) < 0.45 * np.linalg.norm(told)


def test_a_polynomial_tells_errors_of_the_look_at_other_positions():
    parameters, rng = look_parameters(get_system("acrobot").compile(), (64, 64)), np.random.default_rng(0)

    def squashed(q: np.ndarray) -> np.ndarray:
        upper, lower = q[0], q[0] + q[1]
        return np.array([np.sin(2 * upper), np.sin(2 * lower) - np.sin(2 * upper)])

    changes = [
        Change(q, squashed(q)[:, None] * [p.name == "aspect" for p in parameters]) for q in rng.uniform(-3, 3, (60, 2))
    ]
    errors = LookErrors.of(parameters, np.full(len(parameters), 0.02), np.array([True, True]), changes)
    still = ("aside", "above", "nearer", "blur")  # they move what is behind, and nothing
    assert [p.name for p in errors.parameters] == [p.name for p in parameters if p.name not in still]
    observation = JointPositions(get_system("acrobot").compile(), tracked=True, by_look=errors)
    values = np.array([1.5 if n.name == "error of camera: aspect" else 0.0 for n in observation.nuisances])
    q = rng.uniform(-3, 3, (5, 7, 2))
    shown = observation.predict(q, np.zeros_like(q), values)
    expected = 1.5 * 0.02 * np.moveaxis(squashed(np.moveaxis(q, -1, 0)), 0, -1)
    assert shown - q == pytest.approx(expected, abs=1e-3)


def test_what_all_frames_leave_alike_counts_once():
    rng = np.random.default_rng(1)
    noise, common = rng.normal(size=(24, 5000)), rng.normal(size=5000)
    assert design_effect(list(noise)) == pytest.approx(1.0, abs=0.1)
    assert design_effect([common] * 24) == pytest.approx(24.0)
    assert design_effect(list(noise + common)) == pytest.approx(1 + 23 / 2, rel=0.1)
