"""Trainings to look at: the page beside a run, TensorBoard's files, and the list of runs."""

import base64
import io
import json
import re
import struct
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from keycld_control.cli import main
from keycld_control.runs.page import NAME, TrainingPage, html_page
from keycld_control.runs.strip import MAGNIFIED, strip
from keycld_control.runs.trackers import tracker
from keycld_control.runs.watching import watching
from keycld_envs.collect import CollectSettings, make_env, record_episode
from keycld_envs.errors import InputError
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.checkpoint import write_checkpoint
from keycld_model.stored import shipped_models
from keycld_model.training import log

LOG: list[dict[str, Any]] = [
    {"step": 100, "stage": "discover", "loss": 4.0, "seconds": 1.5},
    {"step": 200, "stage": "fit", "loss": 0.25, "validation_vpt": None, "seconds": 3.0},
    {"step": 300, "stage": "fit", "validation_vpt": 0.75, "seconds": 4.0},
]


def write_log(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for entry in LOG:
        log.append(folder, entry)
    return folder


def points(page: str) -> dict[str, list[list[float]]]:
    """x and y of all curves, by name."""
    found = re.search(r'Plotly\.newPlot\(\s*"[^"]+",\s*(\[.*?\]),\s*\{"template', page, re.DOTALL)
    assert found
    out: dict[str, list[list[float]]] = {}
    for trace in json.loads(found[1]):
        out.setdefault(trace["name"], []).append([*trace["x"], *trace["y"]])
    return out


def test_page_has_the_curves_of_the_log_and_asks_to_be_read_again() -> None:
    page = html_page("Training", LOG, 400, finished=False)
    assert points(page) == {"discover": [[100, 4.0]], "fit": [[200, 0.25], [300, 0.75]]}
    assert 'http-equiv="refresh"' in page and 'max="400" value="300"' in page
    assert "<script src" not in page  # nothing else is needed to look at it
    assert 'http-equiv="refresh"' not in html_page("Training", LOG, 400, finished=True)


def test_page_is_written_at_the_end_however_short_the_training(tmp_path: Path) -> None:
    page = TrainingPage(write_log(tmp_path), "<Training>", None, None)
    page.saved(None, finished=False)
    log.append(tmp_path, {"step": 301, "stage": "end", "loss": 7.0})
    page.saved(None, finished=False)  # too soon
    assert "end" not in points((tmp_path / NAME).read_text())
    page.saved(None, finished=True)
    text = (tmp_path / NAME).read_text()
    assert points(text)["end"] == [[301, 7.0]]
    assert "<h1>&lt;Training&gt;</h1>" in text


@pytest.mark.render
@pytest.mark.slow
def test_strip_shows_frames_keypoints_and_prediction() -> None:
    settings = CollectSettings("KeyCLD/Pendulum-v0", steps=20, seed=90)
    with closing(make_env(settings)) as env:
        recording = record_episode(env, settings, 0)
    model = WorldModel.load("pendulum")
    png = strip(model, Dataset(Path("mine"), (recording,)), predict=True)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(png)))).astype(float)
    side = 64 * MAGNIFIED
    assert picture.shape == (3 * side, 8 * side, 3)
    seen, drawn, predicted = picture.reshape(3, side, -1, 3)
    last = recording.load_frames()[-1].astype(float).repeat(MAGNIFIED, 0).repeat(MAGNIFIED, 1)
    ringed = np.abs(seen[:, -side:] - last).max(axis=2) > 0
    assert 0 < ringed.mean() < 0.02  # a ring, and nothing else
    assert np.abs(drawn[:, -side:] - last).mean() < 2
    assert np.abs(predicted[:, -side:] - last).mean() < 4


def test_tensorboard_gets_every_number(tmp_path: Path) -> None:
    event = pytest.importorskip("tensorboardX.proto.event_pb2").Event
    with tracker("tensorboard", tmp_path, {}) as watcher:
        for entry in LOG:
            watcher.logged(entry)
    (path,) = (tmp_path / "tensorboard").iterdir()
    data, found, at = path.read_bytes(), {}, 0
    while at < len(data):  # TFRecord: length, its checksum, record, its checksum
        (length,) = struct.unpack_from("<Q", data, at)
        event = event.FromString(data[at + 12 : at + 12 + length])
        found |= {(event.step, value.tag): value.simple_value for value in event.summary.value}
        at += 16 + length
    assert found == {
        (100, "discover/loss"): 4.0,
        (100, "seconds"): 1.5,
        (200, "fit/loss"): 0.25,
        (200, "seconds"): 3.0,
        (300, "validation_vpt"): 0.75,
        (300, "seconds"): 4.0,
    }


def test_runs_are_listed_with_their_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, folder in shipped_models().items():
        (tmp_path / "done" / name).mkdir(parents=True)
        (tmp_path / "done" / name / "checkpoint.json").write_text((folder / "checkpoint.json").read_text())
    meta = {"config": {"system": None}, "preset": "nc", "seed": 7}
    write_checkpoint(write_log(tmp_path / "running") / "state", {"a": np.zeros(1)}, meta)
    assert main(["runs", str(tmp_path), "--json"]) == 0
    runs = {run["folder"]: run for run in json.loads(capsys.readouterr().out)["runs"]}
    assert list(runs) == ["done/acrobot", "done/cartpole", "done/pendulum", "running"]
    assert runs["done/cartpole"]["of"] == "KeyCLD/Cartpole-v0" and runs["done/cartpole"]["finished"]
    shipped = json.loads((shipped_models()["cartpole"] / "checkpoint.json").read_text())
    assert runs["done/cartpole"]["validation_vpt"] == shipped["validation_vpt"]
    running = runs["running"]
    assert (running["seed"], running["step"], running["validation_vpt"]) == (7, 300, 0.75)
    assert not running["finished"]
    assert main(["runs", str(tmp_path)]) == 0
    assert "unfinished" in capsys.readouterr().out
    (tmp_path / "running/state/checkpoint.json").write_text("{")
    assert main(["runs", str(tmp_path)]) == 2
    assert main(["runs", str(tmp_path / "nowhere")]) == 2
    capsys.readouterr()
    (tmp_path / "empty").mkdir()
    assert main(["runs", str(tmp_path / "empty")]) == 2
    assert "There is no training below" in capsys.readouterr().err


def test_a_list_of_runs_on_80_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    many = tmp_path / "a-rather-long-name-of-a-study" / "cartpole-without-constraints"
    cartpole = (shipped_models()["cartpole"] / "checkpoint.json").read_text()
    joints = {"joint_model": {"joints": ["shoulder_pan", "shoulder_lift", "elbow_flex"], "family": "residual"}}
    about = {"system": "lab/my <swing>.py", "preset": "default", "seed": 7, "data": "d"}
    metas = {
        many / "seed-1": json.loads(cartpole) | {"step": 12345},
        tmp_path / "joints": joints | {"seed": 12, "steps": 123456, "seconds": 98765.0, "validation_error": 0.000123},
        tmp_path / "own": {"config": {"system": None}, "preset": "default", "seed": 7},
        tmp_path / "older": {"config": {"system": None}, "preset": "default", "seed": 7},
    }
    for folder, meta in metas.items():
        folder.mkdir(parents=True)
        (folder / "checkpoint.json").write_text(json.dumps(meta))
    write_checkpoint(write_log(tmp_path / "running") / "state", {"a": np.zeros(1)}, metas[tmp_path / "own"])
    with watching(tmp_path / "page", about) as (page,):
        page.saved(None, finished=True)
    (tmp_path / "page" / NAME).rename(tmp_path / "own" / NAME)
    assert main(["runs", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    lines = [line.split() for line in out.splitlines()]
    at = lines.index(["a-rather-long-name-of-a-study/cartpole-without-constraints/seed-1"])
    assert lines[at + 1][:3] == ["Cartpole-v0", "default", "0"]
    words = out.split()
    assert {"shoulder_pan,", "shoulder_lift,", "elbow_flex", "residual", "123,456", "300*"} <= set(words)
    assert "my <swing>.py" in out and "own mechanism" in out and out.endswith("* unfinished\n")
    assert main(["runs", str(many)]) == 0
    header, row = capsys.readouterr().out.splitlines()
    assert header.split() == ["run", "of", "preset", "seed", "step", "minutes", "VPT"]
    assert row.split()[:3] == ["seed-1", "Cartpole-v0", "default"]


def test_a_missing_tracker_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(InputError, match=r"'keycld\[wandb\]'"), tracker("wandb", tmp_path, {}):
        pass
