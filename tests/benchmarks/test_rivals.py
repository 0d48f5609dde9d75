"""Gates of concealed effects asked of other methods: what they say, and how a run goes on where it stopped."""

import copy
import json
import os
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.json_lines import add_line, read_lines
from keycld_control.benchmarks.real.concealed import ConcealedGate, Running
from keycld_control.benchmarks.real.gate import RecordingFile, Runs
from keycld_control.benchmarks.real.rivals.deviations import ALARM, Difference, answer, covariance
from keycld_control.benchmarks.real.rivals.methods import get_method
from keycld_control.benchmarks.real.side_by_side import HEADER, rows
from keycld_control.benchmarks.real.simulators import Link, Pendulum
from keycld_control.cli import main
from keycld_envs.conceal import conceal
from keycld_envs.effects import ActuatorGain, CoulombFriction, Effect, ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Columns

DATA = Path(os.environ.get("KEYCLD_REAL", Path(__file__).parents[2].parent / "shared" / "real"))
PENDULUM = Pendulum(Link(1.0, 0.5, 0.3), motor=True).model(Path())
COLUMNS = Columns("t", {"hinge": "q"}, actions={"motor": "u"}, units={"q": "rad"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six runs of a pendulum with viscous friction that its model lacks, under random torques."""
    out = tmp_path_factory.mktemp("runs")
    model, rng = copy.copy(PENDULUM), np.random.default_rng(5)
    model.dof_damping[:], model.opt.timestep = 0.05, 0.002
    for i in range(6):
        data, lines = mujoco.MjData(model), ["t,q,u"]
        data.qpos[:] = rng.uniform(-1, 1)
        for k in range(500):
            data.ctrl[:] = rng.uniform(-2, 2) if k % 10 == 0 else data.ctrl
            lines.append(f"{0.01 * k:.2f},{data.qpos[0] + rng.normal(0, 3e-4)},{data.ctrl[0]}")
            mujoco.mj_step(model, data, 5)
        (out / f"{i}.csv").write_text("\n".join(lines))
    return out


FILES = [RecordingFile(f"{i}.csv", COLUMNS, f"run {i}", "MIT", "a simulation") for i in range(6)]


def recordings(folder: Path) -> list[Recording]:
    return [file.recording(folder) for file in FILES]


def gate(files: Sequence[RecordingFile] = FILES, seed: int = 3) -> ConcealedGate:
    return ConcealedGate(
        "G9", "", [Runs("pendulum", Pendulum(Link(1.0, 0.5, 0.3), motor=True).model, files, 0.2)], 2, 0.5, seed
    )


@pytest.mark.long
@pytest.mark.parametrize("method, package", [("sindy", "pysindy"), ("sysid", "colorama")])
def test_rivals_name_friction_and_gain_and_no_change_where_there_is_none(
    method: str, package: str, folder: Path
) -> None:
    pytest.importorskip(package)
    runs = recordings(folder)
    effects: dict[Effect, float] = {
        ViscousFriction("hinge", 0.3): 0.3,
        CoulombFriction("hinge", 0.4): 0.4,
        ActuatorGain("motor", 1.5): 1.5,
    }
    for effect, size in effects.items():
        new = [conceal(r, PENDULUM, effect).recording for r in runs[:2]]
        told = get_method(method)(new, runs[2:], PENDULUM)
        assert told.verdict == "mismatch" and told.changes[0].effect == effect.id
        assert told.changes[0].where == effect.where
        (estimate,) = told.changes[0].parameters.values()
        assert estimate.value == pytest.approx(size, rel=0.2) and estimate.low < estimate.value < estimate.high
    assert get_method(method)(runs[:2], runs[2:], PENDULUM).verdict == "no_mismatch"


def test_finished_cases_are_kept_and_not_run_again(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    one = Running("sindy", 1, 1, tmp_path)
    assert [c["case"] for c in gate().run(folder, one).numbers["cases"]] == [0]
    file = gate().lines(tmp_path, "sindy")
    (line,) = read_lines(file)
    file.write_text(json.dumps(line | {"seconds": 1e6}) + "\n")  # which it can have from the file only
    both = gate().run(folder, replace(one, cases=None))
    assert [c["case"] for c in both.numbers["cases"]] == [0, 1] and both.numbers["longest_s"] == 1e6
    assert len(read_lines(file)) == 2
    kept = file.read_text()
    other = gate(seed=4).run(folder, one)
    assert isinstance(other.error, InputError) and str(file) in str(other.error) and file.read_text() == kept
    assert len(rows({"sindy": both})[0]) == len(HEADER)


@pytest.mark.long
def test_a_case_does_not_depend_on_the_others_nor_on_processes(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    alone = gate().case(1, folder, "sindy").grade()
    second = gate().run(folder, Running("sindy", 2, 2, tmp_path)).numbers["cases"][1]
    assert {k: second[k] for k in ("truth", "findings", "new")} == {k: alone[k] for k in ("truth", "findings", "new")}


def test_a_method_that_refuses_recordings_is_no_error_of_the_gate(tmp_path: Path) -> None:
    rows = "\n".join(f"{0.01 * k:.2f},{np.sin(0.1 * k)},{np.cos(0.3 * k)}" for k in range(30))
    (tmp_path / "short.csv").write_text("t,q,u\n" + rows)
    short = RecordingFile("short.csv", COLUMNS, "short", "MIT", "a simulation")
    result = gate([replace(short, id=f"short {i}") for i in range(3)]).run(tmp_path, Running("one set", 1))
    assert result.error is None and result.numbers["failures"] == 1 and not result.passed


@pytest.mark.skipif(find_spec("colorama") is not None, reason="what mujoco.sysid imports is installed")
def test_without_its_packages_a_method_ends_the_run_and_writes_nothing(folder: Path, tmp_path: Path) -> None:
    result = gate().run(folder, Running("sysid", 1, 1, tmp_path))
    assert isinstance(result.error, InputError) and "keycld[sysid]" in str(result.error)
    assert read_lines(gate().lines(tmp_path, "sysid")) == []


def test_lines_are_read_as_they_were_added_and_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "new" / "lines.jsonl"
    assert read_lines(path) == []
    values = [{"a": 1, "b": None}, {"a": [1.5, "é"]}]
    for value in values:
        add_line(path, value)
    assert read_lines(path) == values
    path.write_text(path.read_text() + '{"a": ')
    with pytest.raises(InputError, match=r"lines\.jsonl, line 3"):
        read_lines(path)


def test_standard_deviations_are_those_of_estimates_with_residuals_that_go_on() -> None:
    rng, blocks, length = np.random.default_rng(0), 60, 20
    block = np.repeat(np.arange(blocks), length)
    features = np.repeat(rng.normal(size=(blocks, 2)), length, axis=0)
    estimates, told = [], []
    for _ in range(300):
        noise = np.repeat(rng.normal(size=blocks), length) + 0.1 * rng.normal(size=blocks * length)
        weights = np.linalg.lstsq(features, noise, rcond=None)[0]
        estimates.append(weights)
        told.append(np.diag(covariance(features, noise - features @ weights, block)))
    assert np.sqrt(np.mean(told, axis=0)) == pytest.approx(np.std(estimates, axis=0), rel=0.15)


def test_the_greatest_difference_is_named_and_others_at_its_joint_are_its_rivals() -> None:
    def differs(effect: str, joint: str, deviations: float) -> Difference:
        return Difference(effect, joint, joint, {}, deviations)

    quiet = answer([differs("spring", "a", ALARM - 0.1), differs("unknown", "b", 1.0)])
    assert quiet.verdict == "no_mismatch" and not quiet.changes and quiet.details["deviations"]["unknown at b"] == 1.0
    told = answer([differs("spring", "a", 5.0), differs("unknown", "a", 9.0), differs("cogging", "a", 4.0)])
    assert told.verdict == "mismatch" and told.changes[0].effect == "spring"
    assert set(told.changes[0].rivals) == {"unknown", "cogging"}
    assert answer([differs("unknown", "a", 9.0)]).verdict == "mismatch"


@pytest.mark.parametrize(
    "words, message",
    [
        (["--only", "G3", "--method", "sindy"], "--only G1"),
        (["--only", "G1", "--method", "sindy,nobody"], "nobody"),
        (["--only", "G1", "--method", "sindy", "--cases", "0"], "--cases"),
        (["--only", "G1", "--workers", "0"], "--workers"),
    ],
)
def test_what_cannot_be_asked_is_refused(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["real", str(tmp_path), *words]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.real
@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} does not exist")
def test_two_cases_of_real_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pysindy")
    words = ["real", str(DATA), "--only", "G1", "--method", "sindy", "--cases", "2", "--out", str(tmp_path), "--json"]
    assert main(words) == 0
    cases = json.loads(capsys.readouterr().out)["methods"]["sindy"]["cases"]
    assert [c["rig"] for c in cases] == ["acrobot C.1", "pendubot C.1"]
    assert all(c["failure"] is None and c["seconds"] < 60 for c in cases)
