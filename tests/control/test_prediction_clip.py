"""Clips of predictions: keypoints where the model has them, the recorded image beside the drawn one."""

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from keycld_control.cli import main
from keycld_control.prediction_clip import CAPTION, draw_prediction
from keycld_control.video import PANEL
from keycld_envs import KeyCLDEnv, make
from keycld_model import WorldModel

FRAMES = 6


@pytest.mark.render
def test_recorded_and_expected_stand_side_by_side() -> None:
    model = WorldModel.load("pendulum")
    with make("pendulum") as env:
        bare = env.unwrapped
        assert isinstance(bare, KeyCLDEnv)
        frames = np.stack([bare.render_qpos([0.5 + 0.1 * k]) for k in range(FRAMES)])
    pictures = list(draw_prediction(model, frames, np.zeros((FRAMES - 1, 1)), context=3))
    assert len(pictures) == FRAMES and pictures[0].shape == (PANEL + CAPTION, 2 * PANEL, 3)
    left, right = pictures[0][:PANEL, :PANEL].astype(int), pictures[0][:PANEL, PANEL:].astype(int)
    recorded = np.kron(frames[0], np.ones((PANEL // 64, PANEL // 64, 1)))
    assert np.median(np.abs(left - recorded)) == 0
    assert np.abs(right - recorded).mean() < 8
    column, row = ((model.keypoints(frames[0])[0] * [1, -1] + 1) / 2 * 63 + 0.5) * PANEL / 64
    assert np.abs(left[round(float(row)), round(float(column))] - [255, 210, 63]).max() < 30


@pytest.mark.render
@pytest.mark.long
def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, clip = str(tmp_path / "data"), tmp_path / "clip.mp4"
    assert main(["collect", "pendulum", "--episodes", "2", "--steps", "8", "--out", data, "--json"]) == 0
    assert main(["evaluate", "pendulum", "--data", data, "--video", "clip.txt"]) == 2
    assert ".mp4" in capsys.readouterr().err
    assert main(["evaluate", "pendulum", "--data", data, "--video", str(clip), "--json"]) == 0
    assert iio.imread(clip).shape == (16, PANEL + CAPTION, 2 * PANEL, 3)
