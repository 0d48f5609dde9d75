"""Each frame's own error of positions."""

from dataclasses import replace

import numpy as np
import pytest
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.image_alignment.calibration import EXACT, ErrorModel, ReadAgain, repeatable


def frames(level: float, slope: float, number: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Errors of two joints, the second's as large in all frames, and what is unexplained of each frame."""
    rng = np.random.default_rng(0)
    unexplained = rng.exponential(0.01, number)
    deviation = np.stack([np.sqrt(level + slope * unexplained), np.full(number, 3e-3)], axis=1)
    return rng.normal(0, deviation), unexplained


def test_variances_grow_with_what_is_unexplained():
    errors, unexplained = frames(1e-7, 4e-4)
    found = ErrorModel.of(errors, unexplained)
    assert found.level[0] == pytest.approx(1e-7, abs=4e-8)
    assert found.slope[0] == pytest.approx(4e-4, rel=0.1)
    low, high = found.deviation(np.array([0.0, 0.03]))
    assert low[1] == pytest.approx(3e-3, rel=0.1) and high[1] == pytest.approx(3e-3, rel=0.15)
    assert np.std(errors / found.deviation(unexplained), axis=0) == pytest.approx([1, 1], abs=0.05)


def test_no_frame_is_taken_for_exact():
    errors, unexplained = frames(0.0, 4e-4)
    found = ErrorModel.of(errors, unexplained)
    usual = np.sqrt(np.mean(errors[:, 0] ** 2))
    assert found.deviation(np.zeros(1))[0, 0] == pytest.approx(EXACT * usual, rel=0.2)


def test_positions_that_are_not_read_again_where_they_are_drawn_are_not_told():
    def again(*pixels: float) -> ReadAgain:
        return ReadAgain(np.zeros((len(pixels), 1)), np.zeros(len(pixels)), np.array(pixels))

    assert repeatable([again(0.02, 0.1), again(), again(0.16)])
    assert not repeatable([again(0.02, 0.1), again(0.5, 0.3)])
    assert repeatable([again()])  # no frame was readable


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
