"""The `keycld` command: output, exit codes, and what it does on a machine where something is missing."""

import errno
import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import keycld_control
import keycld_envs
import keycld_model
from keycld_control.cli import command_names, main
from keycld_control.cli._usage import sentence
from keycld_control.cli.doctor import examine
from keycld_envs import SYSTEMS
from keycld_model.stored import shipped_models
from keycld_model.training import PRESETS

COLLECT = ["--steps", "3", "--width", "16", "--height", "16"]


def keycld(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {key: value for key, value in os.environ.items() if key not in ("MUJOCO_GL", "DISPLAY", "PYOPENGL_PLATFORM")}
    command = [sys.executable, "-m", "keycld_control", *words]
    return subprocess.run(command, capture_output=True, text=True, env=env | environment, check=False)


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The one sentence on stderr with which a command refuses its input."""
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("keycld: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_overview_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--help"]):
        assert main(words) == 0
        out = capsys.readouterr().out
        assert all(f"  {name} " in out for name in command_names())
    assert {"collect", "doctor"} <= set(command_names())


def test_the_packages_and_the_command_have_one_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    installed = version("keycld")
    assert capsys.readouterr().out == f"keycld {installed}\n"
    assert {package.__version__ for package in (keycld_envs, keycld_model, keycld_control)} == {installed}


SUBCOMMANDS = {"delan": ("train", "evaluate", "paper")}
"""Of commands whose options are those of their subcommands."""


@pytest.mark.parametrize(
    "words", [[name, *word] for name in command_names() for word in [[w] for w in SUBCOMMANDS.get(name, ())] or [[]]]
)
def test_every_command_explains_itself_without_heavy_imports(words: list[str]) -> None:
    code = (
        "import sys; from keycld_control.cli import main\n"
        f"try: main([*{words!r}, '--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "assert not {'jax', 'OpenGL', 'mujoco'} & sys.modules.keys(), 'import heavy modules inside run()'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "--json" in done.stdout
    assert "(default: " in done.stdout


@pytest.mark.render
def test_collect_prints_one_json_object_and_nothing_else(tmp_path: Path) -> None:
    done = keycld("collect", "acrobot", "--episodes", "2", "--out", str(tmp_path / "a"), "--json", *COLLECT)
    assert done.returncode == 0
    assert done.stderr == ""
    result = json.loads(done.stdout)
    assert result["frames_per_second"] > 0
    assert result | {"frames_per_second": 0} == {
        "system": "KeyCLD/Acrobot-v0",
        "out": str(tmp_path / "a"),
        "episodes": 2,
        "newly_recorded": 2,
        "already_there": 0,
        "frames_per_second": 0,
    }


@pytest.mark.render
def test_collect_prints_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["collect", "acrobot", "--episodes", "1", "--out", str(tmp_path / "a"), *COLLECT]) == 0
    assert "KeyCLD/Acrobot-v0" in capsys.readouterr().out


def test_input_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "a")
    assert "did you mean 'collect'" in refused(capsys, "colect")
    assert "acrobot" in refused(capsys, "collect", "acrobat", "--out", out)
    assert "'constant'" in refused(capsys, "collect", "acrobot", "--out", out, "--policy", "constnt")
    assert "episodes" in refused(capsys, "collect", "acrobot", "--out", out, "--episodes", "0")
    assert "steps" in refused(capsys, "collect", "acrobot", "--out", out, "--steps", "1")
    assert not Path(out).exists()
    with pytest.raises(SystemExit) as end:
        main(["collect", "acrobot", "--out", out, "--seed", "one"])
    assert end.value.code == 2


USAGE = {
    "import x.mp4 --out o --pivot 640": "--pivot takes 2 numbers, not '640'; see `keycld import --help`.",
    "import x.mp4 --out o --pivot a b": "--pivot takes 2 numbers, not 'a b'; see `keycld import --help`.",
    "import x.mp4 --out o --crop a b c": "--crop takes 3 whole numbers, not 'a b c'; see `keycld import --help`.",
    "import x.mp4 --out o --fps fast": "--fps takes a number, not 'fast'; see `keycld import --help`.",
    "import x.mp4 --pivot 640": "--out PATH is missing; see `keycld import --help`.",
    "import x.csv --otu o": (
        "--out PATH is missing; there is no option --otu (did you mean --out?); see `keycld import --help`."
    ),
    "collect pendulum --episodes two --out d": (
        "--episodes takes a whole number, not 'two'; see `keycld collect --help`."
    ),
    "collect pendulum --episods 2 --out d": (
        "There is no option --episods (did you mean --episodes?); see `keycld collect --help`."
    ),
    "collect pendulum --out": "--out needs a value; see `keycld collect --help`.",
    "check a --dat b --otu c": (
        "There is no option --dat (did you mean --data?) or --otu (did you mean --out?); see `keycld check --help`."
    ),
    "check a b": "There is no use for 'b'; see `keycld check --help`.",
    "blind make": "PATH (Folder of the benchmark) is missing; see `keycld blind --help`.",
    "export d": "--to {minari,lerobot,rerun,mjcf} and --out PATH are missing; see `keycld export --help`.",
    "export d --to nothing --out d": (
        "--to takes lerobot, minari, mjcf or rerun, not 'nothing'; see `keycld export --help`."
    ),
    "train pendulum --data d --out o --log x": (
        "--log takes tensorboard, trackio or wandb, not 'x'; see `keycld train --help`."
    ),
    "delan": "A subcommand is missing: train, evaluate, paper or real; see `keycld delan --help`.",
    "delan trian": (
        "There is no subcommand 'trian'; there are train, evaluate, paper and real; see `keycld delan --help`."
    ),
    "delan train x": "--out PATH is missing; see `keycld delan train --help`.",
}
"""Line of words -> the sentence about an option that cannot be understood."""


@pytest.mark.parametrize("words", USAGE)
@pytest.mark.parametrize("columns", ["40", "200"])
def test_options_that_cannot_be_understood(
    words: str, columns: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
    assert capsys.readouterr() == ("", f"keycld: {USAGE[words]}\n")
    assert os.environ["COLUMNS"] == columns


def test_another_box_is_one_sentence_as_well() -> None:
    box = "╭─ New ─╮\n│ \x1b[1mAnother\x1b[0m reason. │\n│ ───── │\n│ Help  │\n╰───────╯\n"
    assert sentence(box, "keycld check") == "Another reason; see `keycld check --help`."
    assert sentence("", "keycld check") == "The options cannot be understood; see `keycld check --help`."


def test_options_are_refused_where_there_is_no_unicode() -> None:
    done = keycld("collect", "pendulum", "--episodes", "two", "--out", "d", PYTHONIOENCODING="ascii")
    assert done.returncode == 2
    assert done.stderr == "keycld: --episodes takes a whole number, not 'two'; see `keycld collect --help`.\n"


def test_a_width_that_does_not_fit_is_named_as_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "train", "pendulum", "--data", "d", "--out", "o", "--width", "5")
    assert said == "keycld: --width is 5; it must be a multiple of 4, such as 16.\n"


def test_a_full_disk_is_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fail(args: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "data/a")

    monkeypatch.setattr("keycld_control.cli.doctor.run", fail)
    assert (
        refused(capsys, "doctor")
        == "keycld: data/a cannot be written: No space left on device; name another place, or make room there.\n"
    )


def test_ctrl_c(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(args: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("keycld_control.cli.doctor.run", interrupt)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "keycld: interrupted\n"


@pytest.mark.parametrize("words", [["--help"], ["collect", "--help"], ["doctor"], ["doctor", "--json"]])
def test_a_reader_of_the_output_that_leaves(words: list[str]) -> None:
    """As in `keycld doctor | head -n 1`; quiet, with the exit code of a program that SIGPIPE ends."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "keycld_control", *words]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


def test_other_pipes_that_break_are_not_hidden(monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    def fail(args: Any) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("keycld_control.cli.doctor.run", fail)
    with pytest.raises(BrokenPipeError):
        main(["doctor"])


def test_systems_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["systems", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(SYSTEMS)
    assert found["acrobot"]["range"] == [-15, 15] and found["cartpole-stock"]["motors"] == ["slide"]
    assert [name for name, row in found.items() if row["weights"]] == [s for s in SYSTEMS if s in shipped_models()]
    assert main(["systems"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in SYSTEMS) and "KeyCLD/CartpoleStock-v0" in out


def test_presets_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["presets", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {name: row["steps"] for name, row in found.items()} == {name: p.steps for name, p in PRESETS.items()}
    assert main(["presets"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in PRESETS)


@pytest.mark.render
def test_doctor_on_a_complete_machine(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"], report["advice"]
    assert report["advice"] == []
    assert report["python"].split(".")[:2] == [str(part) for part in sys.version_info[:2]]
    assert {"mujoco", "jax", "gymnasium"} <= report["packages"].keys()
    assert report["packages"]["mujoco"]["ok"]
    assert report["opengl"]["backend"]
    assert report["frames_per_second"]["fast"] > 0
    assert main(["doctor"]) == 0
    assert "Everything works." in capsys.readouterr().out


@pytest.fixture(scope="module")
def no_opengl(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment for subprocesses in which no OpenGL library can be loaded."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "sitecustomize.py").write_text(
        "import ctypes, ctypes.util\n"
        "load, find = ctypes.CDLL.__init__, ctypes.util.find_library\n"
        "hidden = lambda name: any(word in str(name) for word in ('GL', 'OSMesa'))\n"
        "def refuse(self, name, *args, **kwargs):\n"
        "    if hidden(name): raise OSError(f'{name}: cannot open shared object file')\n"
        "    load(self, name, *args, **kwargs)\n"
        "ctypes.CDLL.__init__ = refuse\n"
        "ctypes.util.find_library = lambda name: None if hidden(name) else find(name)\n"
    )
    return {"PYTHONPATH": str(folder)}


@pytest.mark.parametrize("backend", ["egl", "osmesa", "disabled", None])
def test_doctor_without_opengl(no_opengl: dict[str, str], backend: str | None) -> None:
    environment = no_opengl | ({"MUJOCO_GL": backend} if backend else {})
    done = keycld("doctor", "--json", **environment)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert not report["ok"]
    assert report["frames_per_second"] is None
    assert report["opengl"]["error"]
    assert "apt-get install libegl1" in report["advice"][0]
    assert ("unset MUJOCO_GL" in report["advice"][0]) == (backend is not None)
    assert report["packages"]["mujoco"]["ok"]


def test_a_backend_that_cannot_be_is_said_before_anything_imports_mujoco(tmp_path: Path) -> None:
    done = keycld("loop", "pendulum", "--conceal", "1", "--out", str(tmp_path / "loop"), MUJOCO_GL="nonsense")
    assert done.returncode == 2
    assert (
        done.stderr
        == "keycld: MUJOCO_GL is 'nonsense', which is no OpenGL backend here; unset it, or use egl or osmesa.\n"
    )


def test_completion_imports_no_mujoco() -> None:
    code = (
        "import sys; from keycld_control.cli import main; assert main(['completion', 'bash']) == 0; "
        "sys.exit('mujoco' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_bench_without_opengl_is_refused_in_one_sentence(no_opengl: dict[str, str]) -> None:
    done = keycld("bench", "--only", "envs", **no_opengl)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "apt-get install libegl1" in done.stderr


def test_collect_without_opengl_is_refused_in_one_sentence(no_opengl: dict[str, str], tmp_path: Path) -> None:
    for workers in ("1", "2"):
        out = str(tmp_path / workers)
        done = keycld("collect", "acrobot", "--episodes", "2", "--workers", workers, "--out", out, **no_opengl)
        assert done.returncode == 2, done.stderr
        assert "libegl1" in done.stderr
        assert "Traceback" not in done.stderr


def test_doctor_names_a_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("keycld_control.cli.doctor.requires", lambda name: ["numpy>=2", "mujoco>=99", "nowhere-at-all"])
    monkeypatch.setattr("keycld_control.cli.doctor._opengl", lambda: {"error": None, "frames_per_second": {}})
    report = examine()
    assert [found["ok"] for found in report["packages"].values()] == [True, False, False]
    assert "mujoco>=99 is required" in report["advice"][0]
    assert "nowhere-at-all is missing" in report["advice"][1]


def test_doctor_survives_a_driver_that_kills_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/bin/false")
    report = examine()
    assert not report["ok"]
    assert report["opengl"]["error"] == "the renderer ended with code 1"


@pytest.mark.parametrize(
    "text", ["[1, 2]", "null", '"x"', '{"findings": [5]}', '{"findings": [{"effect": [], "where": 3}]}']
)
def test_corrections_of_another_shape(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.json").write_text(text)
    assert main(["swingup", "pendulum", "--corrections", str(tmp_path / "x.json")]) == 2
    assert "x.json" in capsys.readouterr().err


def test_a_clip_that_cannot_be_written_is_told_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    clip = str(tmp_path / "file" / "x.mp4")
    assert main(["swingup", "pendulum", "--episodes", "1000000", "--video", clip]) == 2
    assert "is no folder" in capsys.readouterr().err


def test_a_mechanism_does_not_stand_in_the_way_of_a_module(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "numpy"]) == 2
    assert "'numpy'" in capsys.readouterr().err and not Path("numpy.py").exists()
