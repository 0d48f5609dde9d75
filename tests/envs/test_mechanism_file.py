"""A system in a Python file goes by the file's path, in all processes, wherever the file is moved."""

import json
import os
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import keycld_envs
from keycld_control.cli import main
from keycld_envs import InputError
from keycld_envs.mechanism_file import read_mechanism, read_system
from keycld_envs.recordings import read_dataset
from keycld_envs.registration import bare_id, same_system
from keycld_model.diagnosis import Source

ARM = (resources.files("keycld_control.starters") / "two_links.py").read_text(encoding="utf-8")


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The working folder, in which lab/arm.py declares a system."""
    monkeypatch.chdir(tmp_path)
    Path("lab").mkdir()
    Path("lab/arm.py").write_text(ARM)
    yield
    gym.registry.pop("arm.py", None)


@pytest.mark.usefixtures("lab")
def test_a_path_names_an_environment() -> None:
    assert keycld_envs.resolve_env_id("./lab/arm.py") == "lab/arm.py"
    env = keycld_envs.make("lab/arm.py", obs_type="state")
    assert env.reset(seed=0)[0].shape == (4,)
    assert keycld_envs.system_of("lab/arm.py") is read_system("lab/arm.py")
    assert read_mechanism("lab/arm.py") == read_system("lab/arm.py").mechanism
    assert Source.of_environment("lab/arm.py").environment == "lab/arm.py"


@pytest.mark.usefixtures("lab")
def test_a_file_that_was_changed_is_read_anew() -> None:
    before = keycld_envs.system_of("lab/arm.py")
    Path("lab/arm.py").write_text(ARM.replace("timestep=0.01", "timestep=0.02 "))
    assert (before.timestep, keycld_envs.system_of("lab/arm.py").timestep) == (0.01, 0.02)


@pytest.mark.usefixtures("lab")
def test_the_file_s_name_tells_whether_two_are_the_same() -> None:
    assert bare_id("lab/arm.py") == "arm.py"
    assert same_system("elsewhere/arm.py", "lab/arm.py")  # the recordings were moved
    assert not same_system("lab/other.py", "lab/arm.py")
    assert not same_system("KeyCLD/Acrobot-v0", "lab/arm.py")


@pytest.mark.usefixtures("lab")
def test_what_a_file_prints_is_no_result(capsys: pytest.CaptureFixture[str]) -> None:
    Path("lab/arm.py").write_text(ARM + "\nprint('hello')\n")
    read_system("lab/arm.py")
    assert capsys.readouterr() == ("", "hello\n")


@pytest.mark.usefixtures("lab")
def test_the_mjcf_lies_beside_the_file() -> None:
    Path("lab/arm.xml").write_text(ARM.split('"""')[3].strip())
    Path("lab/arm.py").write_text(ARM.replace("mjcf=MJCF", 'mjcf=Path("arm.xml")'))
    os.chdir("lab")
    here = read_system("arm.py").compile()
    os.chdir("..")
    assert read_system("lab/arm.py").compile().nv == here.nv == 2


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.usefixtures("lab")
def test_worker_processes_know_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    size = ["--episodes", "2", "--steps", "3", "--width", "16", "--height", "16", "--json"]
    for workers in ("1", "2"):
        assert main(["collect", "lab/arm.py", "--out", f"data-{workers}", "--workers", workers, *size]) == 0
        assert json.loads(capsys.readouterr().out)["system"] == "lab/arm.py"
    one, two = (read_dataset(f"data-{workers}") for workers in (1, 2))
    assert one.sha256 == two.sha256
    os.rename("lab", "moved")  # recordings are read without the file
    assert read_dataset("data-1").system == "lab/arm.py"
    assert np.array_equal(one.sequences().frames, read_dataset("data-2").sequences().frames)
    with pytest.raises(InputError, match="no Python file"):
        Source.of(None, "lab/arm.py")
