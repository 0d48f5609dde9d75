"""`keycld delan`: training, scoring, the report, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from keycld_control.cli import main
from keycld_control.delan import plan, work
from keycld_control.delan.report import interval
from keycld_control.delan.work import results
from keycld_envs.errors import InputError
from keycld_model.delan import presets
from keycld_model.delan.presets import Preset


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The sentence that a command ends with."""
    assert main(["delan", *words]) == 2
    return capsys.readouterr().err


@pytest.mark.long
def test_train_and_evaluate(letters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "run")
    words = ["train", str(letters), "--out", out, "--model", "black_box", "--test", "e,f", "--json"]
    assert main(["delan", *words]) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["motions"] == {"learned": 3, "validation": 1, "test": 2}
    assert first["least_squares"]["torque"] < 1e-20
    assert "Finished, step" in (tmp_path / "run/report.html").read_text()
    assert main(["delan", "evaluate", out, "--data", str(letters), "--only", "e,f", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["scores"]["torque"] == pytest.approx(first["scores"]["torque"])
    assert again["inverse_dynamics_per_second"] > 0
    assert main(["delan", *words[:-1]]) == 0  # a finished run is not trained again
    assert "least squares" in capsys.readouterr().out.lower()
    one = dict(np.load(letters))
    one = {name: x[:, :1] if x.ndim == 2 else x for name, x in one.items()}
    np.savez(tmp_path / "one.npz", **one)
    assert "joint" in refused(["evaluate", out, "--data", str(tmp_path / "one.npz")], capsys)
    assert "seed" in refused([*words, "--seed", "1"], capsys)


def test_input_that_cannot_be_used_is_refused(
    letters: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "run")]
    log = tmp_path / "log.csv"
    log.write_text("t,q,u\n" + "".join(f"{0.01 * i},{np.sin(0.1 * i)},{i % 7}\n" for i in range(50)))
    assert "--action" in refused(["train", str(log), *out, "--time", "t", "--joint", "hinge=q"], capsys)
    assert "'z'" in refused(["train", str(letters), *out, "--test", "z"], capsys)
    assert "rubber" in refused(["train", str(letters), *out, "--friction", "rubber"], capsys)
    assert "nowhere" in refused(["train", "nowhere", *out], capsys)
    assert "validation" in refused(["train", str(letters), *out, "--validation", "0.95"], capsys)
    assert "weights" in refused(["evaluate", str(tmp_path), "--data", str(letters)], capsys)
    assert "'q'" in refused(["paper", "--out", str(tmp_path / "p"), "--data", str(letters)], capsys)
    assert not (tmp_path / "run" / "weights.safetensors").exists()


def test_plan_has_every_model_once() -> None:
    planned = plan.trainings(seeds=5)
    assert len(set(planned)) == len(planned)
    assert sum(t.model == "structured" and t.characters == plan.ALL for t in planned) == 5
    assert sum(t.model == "least_squares" and t.characters == plan.ALL for t in planned) == 1
    assert {t.seed for t in planned if t.characters != plan.ALL} == {0}
    noisy = plan.trainings(seeds=3, noise=0.01)
    assert len({t.name for t in noisy} | {t.name for t in planned}) == len(noisy) + len(planned)
    assert {t.characters for t in noisy} == {plan.ALL}
    with pytest.raises(InputError, match="--noise is 1"):
        plan.trainings(noise=1.0)


def test_intervals_are_those_of_student() -> None:
    assert interval([2.0]) == "2"
    assert interval([1.0, 3.0]) == "2 ± 1e+01"  # 12.7 times the standard error, 1


@pytest.mark.long
def test_report_of_the_characters(
    letters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plan, "TEST", ("e", "f"))
    monkeypatch.setattr(work, "TEST", ("e", "f"))
    monkeypatch.setattr(work, "ALL", 4)
    monkeypatch.setitem(presets.PRESETS, "structured", Preset("structured", "for tests", width=6, iterations=6))
    words = ["delan", "paper", "--out", str(tmp_path / "out"), "--data", str(letters), "--seeds", "1", "--json"]
    words += ["--model", "structured", "--model", "least_squares", "--characters", "17", "--characters", "3"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["models"] == 4
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "results").iterdir()}
    assert main(words) == 0
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "results").iterdir()}
    assert {r["model"] for r in results(tmp_path / "out")} == {"structured", "least_squares"}
    assert main([*words[:6], "--seeds", "2", "--json", "--model", "least_squares", "--noise", "0.01"]) == 0
    noisy = [r for r in results(tmp_path / "out") if r["noise"]]
    exact = [r for r in results(tmp_path / "out") if not r["noise"] and r["model"] == "least_squares"]
    assert len(noisy) == 2 and noisy[0]["scores"]["torque"] != noisy[1]["scores"]["torque"]
    assert min(r["scores"]["torque"] for r in noisy) > 1e6 * max(r["scores"]["torque"] for r in exact)
    assert "as noise" in (tmp_path / "out" / "report.md").read_text()
    assert "structured Lagrangian" in (tmp_path / "out" / "report.md").read_text()
    assert (tmp_path / "out" / "report.html").stat().st_size > 1e6  # plotly.js is inside
