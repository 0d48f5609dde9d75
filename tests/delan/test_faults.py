"""Joint models whose training is killed or interrupted, and archives, logs and folders that make no sense."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keycld_control.cli import main
from keycld_envs.recordings import write_recording
from keycld_model.checkpoint import flatten, read_checkpoint
from keycld_model.delan import JointModel, Preset, presets, read_motions
from keycld_model.delan.baseline import fit_baseline

from .test_reading import recording

SMALL = Path(__file__).parent.parent / "reliability" / "small_delan.py"
STOPPED_AT = 3
"""Steps of six."""


def weights(folder: Path) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in flatten(read_checkpoint(folder)[0]).items()}


def stopped(command: list[str], out: Path, how: signal.Signals) -> tuple[int, str]:
    """Exit code and errors of a training that gets a signal in the middle."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        deadline, log = time.monotonic() + 300, out / "log.jsonl"
        while not log.exists() or log.read_text().count("\n") < STOPPED_AT:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.002)
        process.send_signal(how)
        errors = process.communicate(timeout=120)[1]
    return process.returncode, errors


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="sends signals")
def test_what_is_killed_or_interrupted_goes_on_to_the_same_model(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(SMALL), "data", str(tmp_path)], check=True)

    def train(out: str) -> list[str]:
        return [sys.executable, str(SMALL), "train", str(tmp_path / "letters.npz"), "--out", str(tmp_path / out)]

    subprocess.run(train("whole"), check=True, capture_output=True)
    for how, code in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
        out = tmp_path / how.name
        ended, errors = stopped(train(how.name), out, how)
        assert ended == code, errors
        assert "Traceback" not in errors and not (out / "weights.safetensors").exists()
        subprocess.run(train(how.name), check=True, capture_output=True)
        assert weights(out) == weights(tmp_path / "whole")
        assert (out / "log.jsonl").read_text().count("\n") == (tmp_path / "whole/log.jsonl").read_text().count("\n")
        assert {p.name for p in out.iterdir()} == {p.name for p in (tmp_path / "whole").iterdir()}


def told(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one sentence of a command that is refused."""
    assert main(["delan", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "Traceback" not in error, error
    return error


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda x: x.update(lengths=np.array([60.0] * 5 + [np.nan])), "lengths"),
        (lambda x: x.update(lengths=np.array([-60, 180, 60, 60, 60, 60])), "lengths"),
        (lambda x: x.update(lengths=np.array([0, 120, 60, 60, 60, 60])), "lengths"),
        (lambda x: x.update(lengths=np.array(["a"] * 6)), "lengths"),
        (lambda x: x.update(t=np.array(["x"] * 360)), " t "),
        (lambda x: x.update(t=np.where(np.arange(360) == 7, np.nan, x["t"])), " t "),
        (lambda x: x.update(t=x["t"][::-1]), "clock"),
        (lambda x: x.update(t=0 * x["t"]), "clock"),
        (lambda x: x.update(qp=x["qp"] * 1e200), "positions"),
        (lambda x: x.update(tau=x["tau"] + 1j), "tau"),
        (lambda x: x.update({k: y[:0] for k, y in x.items()}), "qp"),
        (lambda x: x.update({k: y[:, :0] for k, y in x.items() if y.ndim == 2}), "qp"),
        (lambda x: x.update(qv=np.where(x["qv"] > 3, np.inf, x["qv"])), "qv"),
    ],
)
def test_archives_that_make_no_sense_end_in_a_sentence(
    damage: Callable[[dict[str, Any]], object], said: str, letters: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    arrays = dict(np.load(letters))
    damage(arrays)
    np.savez(letters, **arrays)
    assert said in told(["train", str(letters), "--out", str(tmp_path / "run")], capsys)
    assert not (tmp_path / "run" / "weights.safetensors").exists()


@pytest.mark.parametrize("piece", [0, 40, 700, 5000])
def test_archives_that_are_cut_off_are_refused(
    piece: int, letters: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    letters.write_bytes(letters.read_bytes()[:piece])
    assert "letters.npz" in told(["train", str(letters), "--out", str(tmp_path / "run")], capsys)


def test_folders_and_logs_that_make_no_sense_are_refused(
    letters: Path, pendulum: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = ["--out", str(tmp_path / "run")]
    write_recording(tmp_path / "set" / "run", recording())
    (tmp_path / "set" / "run" / "signals.npz").write_bytes(b"PK\x05\x06" + bytes(18))
    assert "signals.npz" in told(["train", str(tmp_path / "set"), *out], capsys)
    (tmp_path / "empty").mkdir()
    assert "empty" in told(["train", str(tmp_path / "empty"), *out], capsys)
    log = tmp_path / "log.csv"
    log.write_text("t,q,u\n" + "".join(f"{0.01 * i},{np.sin(0.1 * i)},{i % 7}\n" for i in range(50)))
    columns = ["train", str(log), *out, "--time", "t", "--joint", "hinge=q"]
    assert "'nothing'" in told([*columns, "--action", "hinge=nothing"], capsys)
    base = fit_baseline(read_motions(pendulum)).save(tmp_path / "base")
    before = JointModel.load(base).parameters["equations"]["coefficients"]
    assert "base" in told(["train", str(pendulum), "--out", str(base)], capsys)
    assert np.array_equal(JointModel.load(base).parameters["equations"]["coefficients"], before)
    (tmp_path / "file").touch()
    assert "file" in told(["train", str(pendulum), "--out", str(tmp_path / "file")], capsys)
    for command in (["paper", "--data", str(letters)], ["real", str(tmp_path)]):
        assert "file" in told([*command, "--only-report", "--out", str(tmp_path / "file")], capsys)
    assert "seed" in told(["train", str(pendulum), *out, "--seed", "-1"], capsys)


@pytest.mark.slow
def test_too_few_samples_for_least_squares_are_enough_for_a_network(
    letters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(presets.PRESETS, "structured", Preset("structured", "for tests", width=3, iterations=2))
    few = {
        k: np.concatenate([x[:2] for x in np.split(x, 6)]) if len(x) == 360 else x for k, x in np.load(letters).items()
    }
    np.savez(letters, **{**few, "lengths": np.full(6, 2)})
    assert main(["delan", "train", str(letters), "--out", str(tmp_path / "run"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["least_squares"] is None and "coefficients" in found["verdict"]
    assert found["scores"]["torque"] > 0
