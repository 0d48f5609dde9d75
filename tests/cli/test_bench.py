"""`keycld bench`: what it reports and refuses; the measuring itself is tested where it lives."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from keycld_control.benchmarks import models, swingup
from keycld_control.benchmarks.envs import speed_figures
from keycld_control.benchmarks.figure import Figure
from keycld_control.benchmarks.weights import Weights
from keycld_control.cli import bench, main
from keycld_control.closed_loop import LoopSettings
from keycld_control.swingup import SwingUpResult
from keycld_envs import REFERENCE_SYSTEMS, InputError
from keycld_envs.collect import CollectSettings, collect
from keycld_envs.recordings import Dataset, read_dataset
from keycld_model.evaluation import Evaluation
from keycld_model.stored import shipped_models

MACHINE = {
    "cpu": "abacus",
    "cpus": 2,
    "load_average": [0.5, 0.5, 0.5],
    "platform": "Linux",
    "python": "3.11",
    "keycld": "0.1.0",
    "opengl": "llvmpipe",
    "packages": {"mujoco": "3.17.0"},
}
SCORES = Evaluation(
    system="KeyCLD/Cartpole-v0",
    split="all",
    sequences=50,
    frames=50,
    context=5,
    epsilon=1e-3,
    vpt_fraction=0.985,
    vpt_interval=(0.97, 1.0),
    vpt_full=45,
    vpt_frame_index=48.0,
    reconstruction_mse=1e-5,
    keypoint_contributions=(0.9, 0.8),
    circular_r2={"slider": 0.9999, "hinge_1": 0.99},
    constraint_residual=1e-3,
)


@pytest.mark.parametrize(
    ("reached", "required", "at_most", "met"),
    [
        (0.99, 0.99, False, True),
        (0.98 - 1e-16, 0.98, False, True),
        (0.979, 0.98, False, False),
        (600.0, 600.0, True, True),
        (601.0, 600.0, True, False),
        (None, 1.0, False, None),
        (0.5, None, False, None),
    ],
)
def test_a_figure_knows_whether_it_is_good_enough(
    reached: float | None, required: float | None, at_most: bool, met: bool | None
) -> None:
    assert Figure(measure="m", system="s", reached=reached, required=required, at_most=at_most).met is met


def test_missing_weights_are_refused_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "machine", lambda: pytest.fail("began to measure"))
    assert main(["bench", "--weights", str(tmp_path), "--system", "acrobot"]) == 2
    captured = capsys.readouterr()
    assert captured.err == f"keycld: There are no weights for acrobot in {tmp_path}; train them.\n"
    assert captured.out == ""
    monkeypatch.setattr("keycld_model.stored.shipped_models", dict)
    assert main(["bench", "--only", "act"]) == 2
    assert f"no weights for {', '.join(REFERENCE_SYSTEMS)} in this installation" in capsys.readouterr().err


def test_damaged_weights_are_refused(tmp_path: Path) -> None:
    (tmp_path / "pendulum").mkdir()
    (tmp_path / "pendulum" / "weights.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match="damaged"):
        Weights(("pendulum",), tmp_path).check()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--episodes", "0"], "episodes is 0"),
        (["--workers", "0"], "workers is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--data", "nowhere"], "nowhere has no folder 'pendulum'"),
    ],
)
def test_options_out_of_range(words: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *words]) == 2
    assert reason in capsys.readouterr().err


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Replaces every measurement by one invented figure; the parts that were asked for."""
    parts: list[str] = []

    def measure(part: str, *_: Any) -> Iterator[Figure]:
        parts.append(part)
        yield Figure(
            measure=part, system="acrobot", reached=0.5, required=0.9, interval=(0.4, 0.6), count=10, details={"a": 1}
        )
        yield Figure(measure=part, system="pendulum", reached=None, required=5.0, details={"reason": "It rains."})

    monkeypatch.setattr(bench, "_measure", measure)
    monkeypatch.setattr(bench, "machine", lambda: MACHINE)
    monkeypatch.setattr(Weights, "check", lambda self: None)
    return parts


def test_the_report(measured: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "reports" / "report.json"
    assert main(["bench", "--json", "--out", str(out), "--only", "act", "--only", "envs"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert json.loads(out.read_text()) == report
    assert measured == ["envs", "act"]
    assert report["complete"] and report["machine"] == MACHINE
    assert report["settings"]["episodes"] == 100
    assert report["figures"][0] == {
        "measure": "envs",
        "system": "acrobot",
        "reached": 0.5,
        "required": 0.9,
        "at_most": False,
        "interval": [0.4, 0.6],
        "count": 10,
        "details": {"a": 1},
        "met": False,
    }


def test_the_table(measured: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["bench"]) == 0
    assert measured == list(bench.PARTS)
    out = capsys.readouterr().out
    for text in ("≥ 0.9", "0.400 – 0.600", "missed", "It rains.", "abacus", "mujoco 3.17.0", "seed 0"):
        assert text in out


def test_what_is_known_is_kept_when_a_part_fails(
    measured: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = bench._measure

    def fails_later(part: Any, *rest: Any) -> Iterator[Figure]:
        if part == "act":
            raise InputError("No power.")
        yield from before(part, *rest)

    monkeypatch.setattr(bench, "_measure", fails_later)
    assert main(["bench", "--out", str(tmp_path / "report.json")]) == 2
    report = json.loads((tmp_path / "report.json").read_text())
    assert not report["complete"]
    assert {figure["measure"] for figure in report["figures"]} == {"envs", "positions"}


def test_the_rows_of_a_model() -> None:
    held_out = models.HeldOut(Dataset(Path(), ()), exact=False, collecting_s=40.0, details={"data_seed": 1})
    meta = {"seconds": 300.0, "preset": "default", "seed": 1}
    vpt, vpt_two, r2, seconds = models.figures_of("cartpole", {5: SCORES, 2: SCORES}, held_out, meta)
    assert (vpt.reached, vpt.required, vpt.met, vpt.interval, vpt.count) == (0.985, 0.98, True, (0.97, 1.0), 50)
    assert vpt.details["same_data_as_training"] is False
    assert (vpt_two.required, vpt_two.met) == (None, None)
    assert (r2.reached, r2.met, r2.details["slider"]) == (0.99, False, 0.9999)
    assert (seconds.reached, seconds.met) == (340.0, True)
    untold = list(models.figures_of("cartpole", {5: SCORES, 2: SCORES}, held_out, {}))[-1]
    assert (untold.reached, untold.met) == (None, None)


@pytest.mark.render
def test_data_of_the_weights_are_collected_again(tmp_path: Path) -> None:
    collect(tmp_path / "pendulum", CollectSettings("KeyCLD/Pendulum-v0", seed=3), episodes=4)
    original = read_dataset(tmp_path / "pendulum")
    made_from = {"sha256": original.sha256, "recordings": 4}
    model: Any = SimpleNamespace(system="KeyCLD/Pendulum-v0", meta={"seed": 3, "validation": 0.25, "data": made_from})
    again = models._held_out(model, "pendulum", None, workers=1)
    assert again.exact and again.collecting_s > 0 and again.details == {"data_seed": 3}
    assert [r.id for r in again.recordings.recordings] == ["episode-00003"]
    assert again.recordings.sha256 == original.split(0.25)[1].sha256
    model.meta["data"]["seed"] = 4
    assert not models._held_out(model, "pendulum", None, workers=1).exact


@pytest.mark.render
def test_data_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "SAMPLE", 2)
    collect(tmp_path / "pendulum", CollectSettings("KeyCLD/Pendulum-v0", steps=3, seed=3), episodes=10)
    model: Any = SimpleNamespace(system="KeyCLD/Pendulum-v0", meta={})
    found = models._held_out(model, "pendulum", tmp_path, workers=1)
    assert not found.exact and found.details == {"data": str(tmp_path / "pendulum")}
    assert len(found.recordings) == 1


def test_speed_without_dm_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dm_control.suite.wrappers", None)
    figures = list(speed_figures(("pendulum",), repeats=1, steps=1))
    assert [(f.reached, f.met, f.required) for f in figures] == [(None, None, 5.0), (None, None, 1.0)]
    assert "Python 3.11 or 3.12" in figures[0].details["reason"]


def test_speed_of_a_system_that_dm_control_lacks() -> None:
    pytest.importorskip("dm_control")
    figures = list(speed_figures(("acrobot-stock",), repeats=1, steps=1))
    assert [f.reached for f in figures] == [None, None]
    assert "acrobot-stock" in figures[0].details["reason"]


@pytest.mark.parametrize("command", [["bench"], ["paper", "--out", "nowhere"]])
def test_systems_that_are_not_there_are_refused(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command, "--system", "acrobat"]) == 2
    error = capsys.readouterr().err
    assert "'acrobat'" in error and all(name in error for name in REFERENCE_SYSTEMS)


def test_every_series_of_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[LoopSettings] = []

    def swing_up(settings: LoopSettings, episodes: int, workers: int) -> SwingUpResult:
        asked.append(settings)
        start = settings.start or ""
        return SwingUpResult(settings.system, start, episodes, episodes - 1, (0.9, 1.0), 1.0, 900.0, 1000.0, 7, "")

    monkeypatch.setattr(swingup, "swing_up", swing_up)
    three = ("pendulum", "cartpole", "acrobot")
    figures = list(swingup.swing_up_success(Weights(three, Path("runs")), episodes=50, seed=7))
    assert [(f.system, f.measure.split()[1]) for f in figures] == [
        *((system, start) for system in three for start in ("random", "hanging")),
        *(("acrobot ±3", start) for start in ("random", "hanging")),
    ]
    assert [f.met for f in figures] == [False] * 6 + [True] * 2
    assert {s.action_limit for s in asked[:6]} == {None} and {s.action_limit for s in asked[6:]} == {3.0}
    assert {s.seed for s in asked} == {7}
    assert asked[0].weights == str(Path("runs") / "pendulum")
    assert len(list(swingup.swing_up_success(Weights(("pendulum",)), episodes=50))) == 2


@pytest.mark.render
@pytest.mark.long
@pytest.mark.skipif("pendulum" not in shipped_models(), reason="no weights for pendulum in this installation")
def test_acting_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "act", "--system", "pendulum", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    (figure,) = report["figures"]
    assert figure["reached"] > 50  # measured above 1000, but other processes may disturb
    assert figure["count"] == 11
    assert report["machine"]["packages"]["jax"]
