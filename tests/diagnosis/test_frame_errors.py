"""Each frame's own error of positions."""

from dataclasses import replace

import numpy as np
import pytest
from films import film, jpeg
from numpy.typing import NDArray
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.calibration import (
    EXACT,
    MOST_ASTRAY,
    ErrorModel,
    ReadAgain,
    _beside,
    read_astray,
    reading_error,
)
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.follow import follow, turning
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import Pose
from keycld_model.image_alignment.scene import STEP, Scene
from keycld_model.turns import nearest_turn


def frames(level: float, slope: float, factor: float = 0.0, number: int = 4000) -> ReadAgain:
    """Errors of two joints, the second's as large in all frames."""
    rng = np.random.default_rng(0)
    unexplained, fit_variance = rng.exponential(0.01, number), 1e-7 * rng.lognormal(0, 1, (number, 2))
    first = np.sqrt(level + slope * unexplained + factor * fit_variance[:, 0])
    errors = rng.normal(0, np.stack([first, np.full(number, 3e-3)], axis=1))
    return ReadAgain(errors, unexplained, fit_variance, np.full(number, 0.02))


def followed(scene: Scene, times: NDArray[np.float64], frames: NDArray[np.uint8]) -> tuple[Bank, Light, list[Pose]]:
    """Poses of frames that are seen as the simulator has them."""
    bank, light = Bank(scene, scene.nominal), Light.unchanged()
    return bank, light, follow(scene, scene.nominal, light, times, frames, bank)


def test_variances_grow_with_what_is_unexplained():
    again = frames(1e-7, 4e-4)
    found = ErrorModel.of([again])
    assert found.level[0] == pytest.approx(1e-7, abs=4e-8)
    assert found.slope[0] == pytest.approx(4e-4, rel=0.1)
    assert found.factor[0] * np.mean(again.fit_variance[:, 0]) < 2e-7
    low, high = found.deviation(np.array([0.0, 0.03]), np.full((2, 2), 1e-7))
    assert low[1] == pytest.approx(3e-3, rel=0.1) and high[1] == pytest.approx(3e-3, rel=0.15)
    said = found.deviation(again.unexplained, again.fit_variance)
    assert np.std(again.error / said, axis=0) == pytest.approx([1, 1], abs=0.05)


def test_variances_grow_with_what_the_curvature_of_the_fit_leaves():
    """As where a frame has something else in it, always, beside which nothing else that is unexplained shows."""
    again = frames(1e-7, 0.0, factor=20.0)
    found = ErrorModel.of([again])
    assert found.factor[0] == pytest.approx(20.0, rel=0.15)
    low, high = found.deviation(np.zeros(2), np.array([[0.0, 0.0], [1e-6, 1e-6]]))
    assert high[0] == pytest.approx(np.sqrt(1e-7 + 2e-5), rel=0.1) and low[0] < 0.25 * high[0]


def test_no_frame_is_taken_for_exact():
    again = frames(0.0, 4e-4)
    usual = np.sqrt(np.mean(again.error[:, 0] ** 2))
    said = ErrorModel.of([again]).deviation(np.zeros(1), np.zeros((1, 2)))
    assert said[0, 0] == pytest.approx(EXACT * usual, rel=0.2)


def test_positions_that_are_not_read_again_where_they_are_drawn_are_not_told():
    def again(*pixels: float) -> ReadAgain:
        number = len(pixels)
        return ReadAgain(np.zeros((number, 1)), np.zeros(number), np.zeros((number, 1)), np.array(pixels))

    assert read_astray([again(0.02, 0.1), again(), again(0.16)]) == 0
    assert 0 < read_astray([again(*[0.1] * 39, 40.0)]) < MOST_ASTRAY  # a single frame of forty
    assert read_astray([again(*[0.1] * 30), again(*[2.0] * 10)]) == 0.25 > MOST_ASTRAY
    assert read_astray([again()]) == 0  # no frame was readable


def test_samples_weigh_by_their_own_errors():
    """The noise that is found is that of a sample that weighs one, and whitened samples are alike."""
    (run,) = recordings("pendulum", 1, number=1, seconds=4.0)
    assert run.qpos is not None
    rng, shape = np.random.default_rng(0), run.qpos.shape
    own = np.where(rng.random(shape) < 0.5, 2e-3, 1.6e-2)
    seen = replace(run, qpos=run.qpos + rng.normal(0, own), qpos_std=own)
    model = get_system("pendulum").compile()
    known = JointPositions(model, typical=np.array([4e-3])).calibrated([seen])
    assert known.noise == pytest.approx([4e-3], rel=0.2)
    assert JointPositions(model).calibrated([seen]).noise > 6e-3
    windows = cut([seen], known, 0.01, 40)
    assert set(np.unique(windows.weight)) == {0.25, 2.0}
    assert np.array_equal(windows.shorter(2).take(np.array([0])).weight, windows.weight[:1, :20])
    missing = np.where(rng.random(shape) < 0.1, np.nan, 1.0)
    gaps = cut([replace(seen, qpos=seen.qpos * missing, qpos_std=own * missing)], known, 0.01, 40)
    assert np.isfinite(gaps.weight).all() and np.isnan(gaps.measured).any()
    assert (cut([seen], JointPositions(model, np.array([1e-3])), 0.01, 40).weight == 1).all()


@pytest.mark.render
def test_turns_that_are_counted_otherwise_are_no_errors():
    """As after half a second in which the mechanism has been out of view, and the frames are followed once more."""
    (run,), _ = film("pendulum", runs=1, frames=24)
    assert run.frames is not None
    times = 0.02 * np.arange(24, dtype=np.float64)
    with Scene(get_system("pendulum").compile(), "fixed", (64, 64), "fast") as scene:
        bank, light, poses = followed(scene, times, run.frames)
        turned = [replace(pose, q=pose.q + 2 * np.pi * (k > 11)) for k, pose in enumerate(poses)]
        again = reading_error(scene, scene.nominal, light, times, run.frames, turned, bank, 0.0)
    assert len(again.error) == 24 and np.abs(again.error).max() < 0.02
    assert read_astray([again]) == 0


@pytest.mark.render
def test_a_single_readable_frame_tells_no_error():
    """Beside others, its own would be none."""
    (run,), _ = film("pendulum", runs=1, frames=4)
    assert run.frames is not None
    times = 0.02 * np.arange(4, dtype=np.float64)
    with Scene(get_system("pendulum").compile(), "fixed", (64, 64), "fast") as scene:
        bank, light, poses = followed(scene, times, run.frames)
        alone = [replace(pose, explained=pose.explained if k == 2 else 0.0) for k, pose in enumerate(poses)]
        assert [pose.readable for pose in alone] == [False, False, True, False]
        nothing = reading_error(scene, scene.nominal, light, times, run.frames, alone, bank, 0.0)
    assert len(nothing.error) == 0
    assert np.isnan(ErrorModel.of([nothing]).usual).all()


@pytest.mark.render
@pytest.mark.parametrize(("system", "blur", "most"), [("pendulum", 0.0, 2), ("acrobot", 0.0, 2), ("pendulum", 0.25, 3)])
def test_errors_in_compressed_films_are_as_large_as_they_are_said_to_be(system: str, blur: float, most: float) -> None:
    """Where drawings are too soft, one frame in place of two would say four times as much."""
    rng = np.random.default_rng(1)

    def develop(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        noisy = image + rng.normal(0, 3, image.shape)
        return jpeg(np.clip(np.round(noisy), 0, 255).astype(np.uint8), 82)

    (run,), (true,) = film(system, runs=1, frames=100, develop=develop)
    assert run.frames is not None and run.t_frame is not None
    halved = HalvedChroma.of([run.frames])
    assert halved is not None
    frames = halved.filmed(run.frames)
    with Scene(get_system(system).compile(), "fixed", (64, 64), "fast", halved) as scene:
        look, light = np.append(scene.nominal[:-1], blur), Light.unchanged()
        bank = Bank(scene, look)
        poses = follow(scene, look, light, run.t_frame, frames, bank)
        again = reading_error(scene, look, light, run.t_frame, frames, poses, bank, 0.0)
        turn = turning(scene.model)
    error = nearest_turn(np.array([pose.q for pose in poses]), true, turn) - true
    said, is_so = np.sqrt(np.mean(again.error**2, axis=0)), np.std(error, axis=0)
    assert (said < most * is_so).all() and (said > 0.8 * is_so).all()


def test_two_frames_are_on_either_side():
    q = np.array([[0.0, 0.0], [0.02, 0.02], [0.04, -0.03], [-0.04, 0.04], [0.05, 0.04], [-0.05, -0.04], [2.0, 0.0]])
    pixel = np.full(2, STEP / 40)  # a pixel is 1/40 rad
    assert set(_beside(q, 0, pixel)) == {2, 3}
    assert set(_beside(q[[0, 1, 4, 5]], 0, pixel)) == {2, 3}
    assert list(_beside(q[[0, 2, 4]], 0, pixel)) == [1]  # the nearest, where all others are on one side
    assert list(_beside(q[:2], 0, pixel)) == [1]  # none is a pixel away
