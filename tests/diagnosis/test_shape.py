"""The shape of forces along the motion, and the regions to which they are confined."""

import numpy as np
import pytest
from plants import problem_of, recordings

from keycld_envs.effects import ActuatorGain, ConstantForce, EndStop, Spring, StribeckFriction
from keycld_envs.systems import get_system
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.output.page.portrait import portrait
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.region import Shape, shape_of


@pytest.fixture(scope="module")
def fit() -> Fit:
    runs = recordings("pendulum", 5, number=3, seconds=1.0)
    problem = problem_of(Simulator(get_system("pendulum").compile(), 0.01), runs)
    return minimise(problem, problem.start(), 3)


def of(fit: Fit, effect) -> Shape:
    shape = shape_of(fit, effect)
    assert shape is not None
    return shape


def test_a_stop_is_confined_to_what_lies_behind_it(fit):
    at = float(np.quantile(of(fit, Spring("hinge", k=1.0)).position, 0.85))
    shape = of(fit, EndStop("hinge", k=2.0, d=0.0, at=at))
    region = shape.region(STANDARD)
    assert region is not None and set(region) >= {"qpos:hinge"}
    low, high = region["qpos:hinge"]
    assert at <= low < high <= shape.position.max() + 1e-4
    inside = (shape.position >= low) & (shape.position <= high)
    assert np.sum(shape.force[inside] ** 2) >= 0.9 * np.sum(shape.force**2) * (1 - 1e-6)


@pytest.mark.parametrize("effect", [ConstantForce("hinge", f=0.05), Spring("hinge", k=0.1, f=0.31)])
def test_springs_and_constant_forces_act_everywhere(fit, effect):
    shape = of(fit, effect)
    assert shape.region(STANDARD) is None
    assert np.allclose(shape.force, effect.torque(np.zeros_like(shape.speed), shape.position, shape.speed))


@pytest.mark.parametrize("effect", [ActuatorGain("torque", k=0.5), StribeckFriction("hinge", c=0.05, extra=0.1)])
def test_what_is_no_force_or_in_part_the_models_own_has_no_shape(fit, effect):
    assert shape_of(fit, effect) is None


def test_the_picture_has_the_force_over_position_and_speed():
    x = np.linspace(-1, 1, 400)
    pictures = portrait(Shape("slider", False, x, np.cos(7 * x), x**2))
    assert len(pictures) == 2 and sum(len(list(picture.iter("circle"))) for picture in pictures) >= 800
    texts = {text.text for picture in pictures for text in picture.iter("text")}
    assert {"position of slider, m", "speed of slider, m/s", "force, N"} <= texts
