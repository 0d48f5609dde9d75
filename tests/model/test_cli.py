"""`keycld train` and `keycld evaluate`: what they print, and what they refuse in one sentence."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from swinging import CONFIG, random_parameters, recordings
from test_training import TINY, initial, rough_errors

from keycld_control.cli import main
from keycld_envs.recordings import write_recording
from keycld_model import WorldModel
from keycld_model.stored import shipped_models
from keycld_model.training import loop

pytestmark = pytest.mark.usefixtures("unoptimised")
SYSTEM = "KeyCLD/Pendulum-v0"


@pytest.fixture
def data(tmp_path):
    for recording in recordings(4, system=SYSTEM):
        write_recording(tmp_path / "data" / recording.id, recording)
    return tmp_path / "data"


@pytest.fixture
def checkpoint(tmp_path):
    config = replace(CONFIG, system=SYSTEM)
    return WorldModel(config, random_parameters(config)).save(tmp_path / "model")


def refused(capsys, *words):
    assert main([str(word) for word in words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("keycld: ")
    assert captured.err.count("\n") == 1
    return captured.err


def damage_actions(data: Path) -> None:
    path = sorted(data.iterdir())[1] / "signals.npz"
    with np.load(path) as file:
        signals = dict(file)
    signals["action"][3] = np.nan
    np.savez(path, **signals)


def test_train_refuses(data, tmp_path, capsys):
    out = tmp_path / "out"

    def train(system="pendulum", **options):
        options = {"data": data, "out": out} | options
        return refused(capsys, "train", system, *(w for key, value in options.items() for w in (f"--{key}", value)))

    assert "nowhere does not exist" in train(data=tmp_path / "nowhere")
    assert "not KeyCLD/Acrobot-v0" in train("acrobot")
    assert "pendulum" in train("pendulm")
    assert "default, quick, nc, node2" in train(preset="papr")
    assert "seed" in train(seed=-1)
    assert "validation" in train(validation=0)
    assert "mechanism declaration" in train(tmp_path / "nowhere.json")
    (tmp_path / "rods.json").write_text('{"num_keypoints": 1}')
    assert "rods.json" in train(tmp_path / "rods.json")
    assert not out.exists()
    damage_actions(data)
    message = train()
    assert "action[3, 0] is nan" in message and "run-01" in message


def test_train_refuses_images_that_no_network_fits(tmp_path, capsys):
    odd = np.zeros((12, 10, 12, 3), np.uint8)
    for recording in recordings(3, system=SYSTEM, frames=odd):
        write_recording(tmp_path / "data" / recording.id, recording)
    message = refused(capsys, "train", "pendulum", "--data", tmp_path / "data", "--out", tmp_path / "out")
    assert "12x10 pixels" in message and "multiples of 8" in message
    for recording in recordings(3, system=SYSTEM, frames=np.zeros((12, 16, 24, 3), np.uint8)):
        write_recording(tmp_path / "oblong" / recording.id, recording)
    message = refused(capsys, "train", "pendulum", "--data", tmp_path / "oblong", "--out", tmp_path / "out")
    assert "24x16 pixels are not square" in message and "keycld crop" in message


@pytest.mark.slow
def test_train_prints_a_summary(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(loop.PRESETS, "default", replace(TINY, stages=TINY.stages[:1]))
    monkeypatch.setattr(loop, "COLLAPSED", 0.0)
    monkeypatch.setattr("keycld_model.modules.Parts.initial", initial)
    monkeypatch.setattr(loop, "prediction_errors", rough_errors)
    monkeypatch.setattr(loop, "spare_keypoint", lambda parts, variables, data: 0)
    out = tmp_path / "out"
    assert main(["train", "pendulum", "--data", str(data), "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    summary = json.loads(said.out)
    warning = "Keypoint 0 follows no part of its own"
    assert warning in said.err and any(warning in sentence for sentence in summary["weaknesses"])
    assert summary.keys() == {"system", "checkpoint", "steps", "seconds", "validation_vpt", "weaknesses", "seed"}
    assert (summary["system"], summary["steps"], summary["checkpoint"]) == (SYSTEM, 6, str(out))
    assert WorldModel.load(out).system == SYSTEM
    assert "Finished, step 6 of 6." in (out / "report.html").read_text()
    assert "another seed" in refused(capsys, "train", "pendulum", "--data", data, "--out", out, "--seed", 5)


def test_evaluate_refuses(data, checkpoint, tmp_path, capsys):
    def evaluate(model=checkpoint, **options):
        options = {"data": data} | options
        return refused(capsys, "evaluate", model, *(w for key, value in options.items() for w in (f"--{key}", value)))

    assert "does not exist" in evaluate(data=tmp_path / "nowhere")
    assert "There is no checkpoint" in evaluate(tmp_path / "nowhere")
    assert "weights.safetensors" in evaluate(data)
    assert "context" in evaluate(context=1)
    assert "frames" in evaluate(frames=1)
    config = replace(CONFIG, system="KeyCLD/Acrobot-v0")
    other = WorldModel(config, random_parameters(config)).save(tmp_path / "other")
    message = evaluate(other)
    assert "KeyCLD/Acrobot-v0" in message and SYSTEM in message and str(other) in message
    large = replace(CONFIG, system=SYSTEM, image_shape=(32, 32))
    model = WorldModel(large, random_parameters(large)).save(tmp_path / "large")
    assert "32, 32, 3]" in evaluate(model)
    (checkpoint / "weights.safetensors").write_bytes(b"no")
    assert "damaged" in evaluate()
    damage_actions(data)
    assert "action[3, 0] is nan" in evaluate(other)


@pytest.mark.slow
def test_evaluate_prints_the_scores(data, checkpoint, capsys):
    assert main(["evaluate", str(checkpoint), "--data", str(data), "--context", "3", "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert {
        "system",
        "sequences",
        "epsilon",
        "vpt_fraction",
        "vpt_interval",
        "vpt_frame_index",
        "reconstruction_mse",
        "keypoint_contributions",
        "circular_r2",
        "constraint_residual",
    } <= scores.keys()
    assert scores["system"] == SYSTEM and scores["sequences"] == 4
    assert scores["circular_r2"].keys() == {"hinge"}


@pytest.mark.slow
def test_data_without_actions_go_with_a_mechanism_without_motors(data, tmp_path, capsys):
    free = {"actuator_names": (), "t_action": None, "action": None, "units": {"qpos": "rad"}}
    for recording in recordings(2, **free):
        write_recording(tmp_path / "free" / recording.id, recording)
    config = replace(CONFIG, mechanism=replace(CONFIG.mechanism, num_actions=0))
    model = WorldModel(config, random_parameters(config)).save(tmp_path / "model")
    assert main(["evaluate", str(model), "--data", str(tmp_path / "free"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sequences"] == 2
    assert "1 actions per frame" in refused(capsys, "evaluate", model, "--data", data)


def test_shipped_weights_go_by_the_systems_name(data, capsys):
    if "pendulum" not in shipped_models():
        pytest.skip("no weights for pendulum in this installation")
    assert "64, 64, 3]" in refused(capsys, "evaluate", "pendulum", "--data", data)
