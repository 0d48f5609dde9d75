"""A mechanism of one's own goes by `module:Namespace/Id-v0` from recording to control, on the command line."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import imageio.v3 as iio
import pytest
from test_training import TINY, initial, rough_errors

from keycld_control import targets
from keycld_control.cli import main
from keycld_envs import resolve_env_id, system_of
from keycld_model.training import loop

pytestmark = pytest.mark.usefixtures("unoptimised")

ENV_ID = "my_module:MyLab/Thing-v0"
MODULE = """
import keycld_envs
from own_mechanism import CRANE

keycld_envs.register(CRANE, "MyLab/Thing-v0", max_episode_steps=30)
"""


def forget() -> None:
    """Every command is a new process, which knows nothing of the module."""
    for name in ("my_module", "own_mechanism"):
        sys.modules.pop(name, None)
    for env_id in ("MyLab/Thing-v0", "Examples/Crane-v0"):
        gym.registry.pop(env_id, None)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, in which the module lies, and a recipe of a few steps."""
    (tmp_path / "my_module.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(Path(__file__).parents[2] / "examples")])
    monkeypatch.setitem(loop.PRESETS, "default", replace(TINY, stages=TINY.stages[:1]))
    monkeypatch.setattr(loop, "COLLAPSED", 0.0)  # a few steps find nothing
    monkeypatch.setattr(targets, "LENGTH_TOLERANCE", math.inf)
    monkeypatch.setattr(targets, "UNEXPLAINED", math.inf)
    monkeypatch.setattr("keycld_model.modules.Parts.initial", initial)
    for module in (loop, sys.modules["keycld_model.evaluation.evaluate"]):
        monkeypatch.setattr(module, "prediction_errors", rough_errors)
    yield tmp_path
    forget()


@pytest.mark.long
@pytest.mark.render
@pytest.mark.filterwarnings("ignore:os.fork")  # imageio starts ffmpeg to read
def test_from_recording_to_control(folder, capsys):
    def keycld(*words: str):
        forget()
        assert main([*words, "--json"]) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    size = ("--width", "16", "--height", "16")
    assert keycld("collect", ENV_ID, "--out", "data", "--episodes", "4", "--steps", "12", *size)["system"] == ENV_ID
    assert keycld("train", ENV_ID, "--data", "data", "--out", "model")["system"] == ENV_ID
    scores = keycld("evaluate", "model", "--data", "data")
    assert (scores["system"], scores["split"], scores["circular_r2"].keys()) == (ENV_ID, "validation", {"hinge"})
    result = keycld("swingup", ENV_ID, "--weights", "model", "--episodes", "1", "--video", "clip.mp4")
    assert (result["system"], result["episodes"]) == (ENV_ID, 1)
    assert len(iio.imread(folder / "clip.mp4")) == 30  # the whole episode


def test_ids_with_a_module(folder, monkeypatch):
    monkeypatch.syspath_prepend(folder)
    forget()
    assert system_of(ENV_ID).name == "crane"
    assert system_of(ENV_ID) is system_of("MyLab/Thing-v0") is system_of("my_module:crane")
    assert resolve_env_id("my_module:crane") == ENV_ID
