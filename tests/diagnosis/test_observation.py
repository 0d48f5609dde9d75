"""What is measured is a seam: the diagnosis knows channels, and joints only through what observes them."""

import zlib

import numpy as np
import pytest
from plants import problem_of, recordings

from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.observation import JointPositions, Nuisance, Observation
from keycld_model.diagnosis.inputs.observation.noise import estimate_noise
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.output.page import html_page
from keycld_model.diagnosis.simulation.simulator import Simulator


class TipPosition:
    """Where a mark at the tip of a pendulum is in the plane: two channels of one joint, off by a scale and an angle."""

    names, units = ("x", "z"), ("m", "m")
    nuisances = (
        Nuisance("scale of x", "scale", 0, 0.02, "1"),
        Nuisance("angle of the mark", "angle", 0, 0.015, "rad"),
    )

    def __init__(self, noise: np.ndarray | None = None) -> None:
        self.noise = np.full(2, np.nan) if noise is None else noise

    def calibrated(self, recordings) -> "TipPosition":
        times = [np.asarray(r.t_state) for r in recordings]
        return TipPosition(estimate_noise(times, [self.measured(r) for r in recordings]))

    def check(self, recording: Recording) -> None:
        assert recording.qpos is not None

    def measured(self, recording: Recording) -> np.ndarray:
        angle = np.asarray(recording.qpos)[:, 0]
        pixels = np.random.default_rng(zlib.crc32(recording.id.encode())).normal(0, 2e-3, (len(angle), 2))
        return np.stack([1.01 * np.sin(angle), np.cos(angle)], axis=-1) + pixels

    def weights(self, recording: Recording) -> None:
        """All samples are alike."""

    def positions(self, measured: np.ndarray) -> np.ndarray:
        return np.pi + np.arctan2(-measured[..., :1], -measured[..., 1:])

    def initial_state(self, time: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        velocity, position = np.polyfit(time[:7], self.positions(measured[:7])[:, 0], 2)[-2:]
        return np.array([position]), np.array([velocity])

    def predict(self, q: np.ndarray, v: np.ndarray, values) -> np.ndarray:
        return np.concatenate([(1 + values[0]) * np.sin(q + values[1]), np.cos(q + values[1])], axis=-1)


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return recordings("pendulum", 2, lambda t, q, v, u: -0.1 * v, number=9, seconds=2.0)


def test_its_errors_are_fitted_and_what_is_left_is_noise(runs):
    tip: Observation = TipPosition().calibrated(runs[::3])
    simulator = Simulator(get_system("pendulum").compile(), 0.01)
    problem = Problem(simulator, cut(runs[::3], tip, 0.01, 40))
    free = minimise(problem, problem.start())
    values = dict(zip((n.name for n in problem.nuisances), free.point.variant.values, strict=True))
    assert values["scale of x"] == pytest.approx(0.01, abs=0.002)
    assert free.residual.shape == (len(problem.windows), 40, 2) and free.chi_square > 1.1  # friction is missing


def test_a_zero_of_an_encoder_shifts_every_sample_alike(runs):
    problem = problem_of(Simulator(get_system("pendulum").compile(), 0.01), runs[:1])
    linear, _ = problem.linearise(problem.start())
    (zero,) = [i for i, nuisance in enumerate(problem.nuisances) if nuisance.kind == "zero"]
    np.testing.assert_allclose(linear.shared[..., zero], 1 / problem.noise[0])


@pytest.mark.long
def test_the_same_friction_is_found_from_the_tip_as_from_the_joint(runs):
    model = get_system("pendulum").compile()
    found = {}
    for name, observation in {"joint": JointPositions(model), "tip": TipPosition()}.items():
        report = diagnose(runs, model, observation=observation)
        assert [(f.effect, f.where["name"]) for f in report.findings] == [("viscous_friction", "hinge")], name
        found[name] = report.findings[0].parameters["b"]
        assert report.verdict == "mismatch"
        assert report.evidence is not None and len(html_page(report)) > 1e6
        assert report.evidence.channels == {"joint": ("hinge",), "tip": ("x", "z")}[name]
    assert found["tip"].value == pytest.approx(found["joint"].value, rel=0.05)
    assert found["tip"].low < 0.1 < found["tip"].high
