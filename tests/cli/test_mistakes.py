"""Mistakes in a mechanism of one's own: each is one sentence that names it, and exit code 2."""

import json
from importlib import resources
from pathlib import Path

import pytest
from PIL import Image

from keycld_control.cli import main

ARM = (
    (resources.files("keycld_control.starters") / "two_links.py")
    .read_text(encoding="utf-8")
    .replace("Rod, System", "Rod, Slider, System")
)
RODS = "rods=(Rod(None, 0), Rod(0, 1))"
MARKS = 'landmarks=(Landmark("upper", (0, 0, 0.8)), Landmark("lower", (0, 0, 0.8)))'
CAMERA = '<camera name="front" pos="0 -5 0" zaxis="0 -1 0"/>'
SHOULDER = '        Joint("shoulder", "hinge", (-math.pi, math.pi)),\n'
ELBOW = '        Joint("elbow", "hinge", (-math.pi, math.pi)),\n'
MOTOR = '<motor name="elbow" joint="elbow" gear="2" ctrllimited="true" ctrlrange="-15 15"/>'
BALL = '<joint name="elbow" type="ball"/>'
LIMITED = '<joint name="elbow" axis="0 1 0" limited="true" range="-90 90"/>'

DECLARED = {
    "syntax": ("system = System(", "system = = System(", "line "),
    "module that is not there": ("import math\n", "import math\nimport numpie\n", "numpie"),
    "exception": ("import math\n", "import math\n1 / 0\n", "ZeroDivisionError"),
    "exit": ("import math\n", "import math\nraise SystemExit(3)\n", "SystemExit"),
    "no variable": ("system = System(", "arm = System(", "no variable 'system'"),
    "another class": ("system = System(", "system = dict(", "a dict under the name 'system'"),
    "argument that is none": ("camera=", "kamera=", "kamera"),
    "argument that is missing": ('    camera="front",\n', "", "camera"),
    "name that is none": ("name=Path(__file__).stem", "name=5", "name of a System"),
    "rod to a missing keypoint": (RODS, "rods=(Rod(None, 0), Rod(0, 2))", "Rod(start=0, end=2)"),
    "rod to itself": (RODS, "rods=(Rod(None, 0), Rod(1, 1))", "ends where it starts"),
    "rod twice": (RODS, "rods=(Rod(None, 0), Rod(0, 1), Rod(1, 0))", "twice"),
    "negative keypoint": (RODS, "rods=(Rod(None, 0), Rod(0, -1))", "end of a Rod"),
    "rod to the pivot": (RODS, "rods=(Rod(None, 0), Rod(0, None))", "end of a Rod"),
    "one rod without its comma": (RODS, "rods=(Rod(None, 0))", "comma"),
    "rods that are numbers": (RODS, "rods=((None, 0), (0, 1))", "tuple of Rod"),
    "no keypoints": ("num_keypoints=2", "num_keypoints=0", "num_keypoints"),
    "keypoints in words": ("num_keypoints=2", 'num_keypoints="two"', "num_keypoints"),
    "more rods than freedom": (RODS, RODS[:-1] + ", Rod(None, 1), Rod(0, 2), Rod(2, 1))", "keypoint"),
    "no freedom left": ("num_keypoints=2", "num_keypoints=1", "names a keypoint outside"),
    "slider without direction": (RODS, RODS + ", sliders=(Slider(1, (0.0, 0.0)),)", "normal"),
    "pivot in space": ("pivot=(0.0, 0.0)", "pivot=(0.0, 0.0, 0.0)", "pivot"),
    "pivot that is no number": ("pivot=(0.0, 0.0)", 'pivot=(0.0, float("nan"))', "pivot"),
    "target in brackets": ("target_qpos=(0.0, 0.0)", "target_qpos=((0.0, 0.0),)", "shape (2,), got (1, 2)"),
    "time in ms": ("timestep=0.01", "timestep=10", "up to 1"),
    "name of a file as a text": ("mjcf=MJCF", 'mjcf="arm.xml"', "mjcf=Path(...)"),
    "folder in place of the MJCF": ("mjcf=MJCF", 'mjcf=Path("..")', "it is a folder"),
    "null byte": ("import math\n", "import math\n\0", "run (SyntaxError"),
    "joint that is called twice": ('Joint("elbow"', 'Joint("shoulder"', "('elbow', 'hinge')]; name all"),
    "kind of joint": ('Joint("elbow", "hinge"', 'Joint("elbow", "hinges"', "'hinges'"),
    "range backwards": ("(-math.pi, math.pi)),\n    )", "(math.pi, -math.pi)),\n    )", "swap"),
    "range of one number": ("(-math.pi, math.pi)),\n    )", "math.pi),\n    )", "start_range"),
    "joint that is left out": (ELBOW, "", "joints"),
    "joints in another order": (SHOULDER + ELBOW, ELBOW + SHOULDER, "joints"),
    "actuator by another name": ('actuators=("shoulder", "elbow")', 'actuators=("shoulder", "elbo")', "elbo"),
    "actuator that is left out": ('actuators=("shoulder", "elbow")', 'actuators=("shoulder",)', "actuators"),
    "actions": ("num_actions=2", "num_actions=1", "1 actions"),
    "landmark that is left out": (MARKS, 'landmarks=(Landmark("upper", (0, 0, 0.8)),)', "1 keypoints"),
    "landmark in the plane": (MARKS, MARKS.replace("(0, 0, 0.8)", "(0, 0.8)", 1), "'upper'"),
    "landmark on no body": (MARKS, MARKS.replace("lower", "lowr"), "'lowr'"),
    "camera by another name": ('camera="front"', 'camera="frnt"', "did you mean 'front'"),
    "no time": ("timestep=0.01", "timestep=0", "timestep"),
    "time that is no multiple": ("timestep=0.01", "timestep=0.012", "multiple"),
    "target of one number": ("target_qpos=(0.0, 0.0)", "target_qpos=(0.0,)", "target_qpos"),
    "rest that is infinite": ("hanging_qpos=(math.pi, 0.0)", "hanging_qpos=(math.inf, 0.0)", "hanging_qpos"),
    "limit below zero": ('camera="front"', 'action_limit=-3.0, camera="front"', "action_limit"),
    "start": ('camera="front"', 'start="rest", camera="front"', "start"),
    "XML": ("</worldbody>", "<worldbody>", "XML"),
    "element": ('<light pos="0 -3 3"/>', "<lamp/>", "lamp"),
    "body without mass": (
        '<geom type="capsule" fromto="0 0 0 0 0 .8" size=".08" mass="1" rgba=".9 .6 .2 1"/>', "", "mass"
    ),
    "ball joint": ('<joint name="elbow" axis="0 1 0"/>', BALL, "joints"),
    "time step of the MJCF": ('timestep="0.005"', 'timestep="5"', "time step"),
    "MJCF that is not there": ("mjcf=MJCF", 'mjcf=Path("arm.xml")', "arm.xml"),
    "actuator of no joint": ('joint="elbow" gear', 'joint="wrist" gear', "wrist"),
}  # fmt: skip
"""Mistake -> (text of the file, what stands in its place, words of the sentence): found without moving anything."""

SEEN = {
    "camera that looks away": (CAMERA, CAMERA.replace('zaxis="0 -1 0"', 'zaxis="0 1 0"'), "behind the camera"),
    "camera from above": (CAMERA, '<camera name="front" pos="0 0 5" zaxis="0 0 1"/>', "towards the camera"),
    "camera askew": (CAMERA, CAMERA.replace('zaxis="0 -1 0"', 'zaxis="0 -1 .3"'), "towards the camera"),
    "camera too near": (CAMERA, CAMERA.replace("0 -5 0", "0 -2 0"), "out of the image"),
    "camera beside": (CAMERA, CAMERA.replace("0 -5 0", "9 -5 0"), "sees no keypoint"),
    "camera far away": (CAMERA, CAMERA.replace("0 -5 0", "0 -90 0"), "camera nearer"),
    "camera 200 m away": (CAMERA, CAMERA.replace("0 -5 0", "0 -200 0"), "'front' is too far away"),
    "camera 500 m away": (CAMERA, CAMERA.replace("0 -5 0", "0 -500 0"), "nearer, to about 7.85 m"),
    "pivot elsewhere": ("pivot=(0.0, 0.0)", "pivot=(0.3, 0.0)", "pivot=(0.000, 0.000)"),
    "rod from the pivot to the far end": (RODS, "rods=(Rod(None, 0), Rod(None, 1))", "rod pivot-1 is not rigid"),
    "rail in place of a rod": (RODS, "rods=(Rod(None, 0),), sliders=(Slider(1),)", "slider 1 leaves its rail"),
    "rod that is left out": (RODS, "rods=(Rod(None, 0),)", "3 degrees of freedom"),
    "landmark on the joint": (MARKS, MARKS.replace("(0, 0, 0.8)", "(0, 0, 0)", 1), "never moves"),
    "landmark on the ground": (MARKS, MARKS.replace("lower", "world"), "never moves"),
    "two landmarks at one place": (MARKS, MARKS.replace('"lower", (0, 0, 0.8)', '"lower", (0, 0, 0)'), "same place"),
    "both landmarks on one body": (
        MARKS, MARKS.replace('"lower", (0, 0, 0.8)', '"upper", (0, 0, 0.4)'), "'elbow' moves no keypoint"
    ),
    "starts beyond the joint's range": ('<joint name="elbow" axis="0 1 0"/>', LIMITED, "outside its range"),
    "range in radians in an MJCF of degrees": (
        '<joint name="elbow" axis="0 1 0"/>', LIMITED.replace("90", "3.14"), 'compiler angle="radian"'
    ),
    "target in degrees": ("target_qpos=(0.0, 0.0)", "target_qpos=(180.0, 0.0)", "math.radians"),
    "starts in degrees": ("(-math.pi, math.pi)", "(-180, 180)", "math.radians"),
    "actuator without effect": (MOTOR, MOTOR.replace('gear="2"', 'gear="0"'), "no effect"),
    "actuator that is too weak": (MOTOR, MOTOR.replace('gear="2"', 'gear="0.001"'), "no effect"),
    "rest that is none": ("hanging_qpos=(math.pi, 0.0)", "hanging_qpos=(1.0, 0.0)", "no equilibrium"),
    "rest that falls": ("hanging_qpos=(math.pi, 0.0)", "hanging_qpos=(0.0, 0.0)", "no stable equilibrium"),
    "target that is too heavy": (
        MOTOR + "\n  </actuator>", MOTOR.replace("-15 15", "-1 1") + "\n  </actuator>", "cannot be held"
    ),
    "link that is invisible": ('.9 .6 .2 1"', '.9 .6 .2 0"', "'elbow' moves keypoints, but nothing that the camera"),
    "geometry that is invisible": ("1\"/>", "0\"/>", "sees nothing"),
}  # fmt: skip
"""The same: found by moving the mechanism and looking at it."""


def complaint(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What stands on stderr, when a command refuses its input."""
    assert main(words) == 2
    return capsys.readouterr().err


def one_sentence(text: str) -> bool:
    return text.startswith("keycld: ") and text.count("\n") == 1 and text.endswith((".\n", "?\n")) and len(text) < 400


def check(folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str) -> str:
    assert old in ARM
    (folder / "arm.py").write_text(ARM.replace(old, new))
    return complaint(capsys, "check", str(folder / "arm.py"), "--out", str(folder / "check.png"))


@pytest.mark.parametrize("mistake", DECLARED)
def test_a_mistake_in_the_declaration(mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, words = DECLARED[mistake]
    said = check(tmp_path, capsys, old, new)
    assert one_sentence(said)
    assert words in said
    assert not (tmp_path / "check.png").exists()


@pytest.mark.render
@pytest.mark.parametrize("mistake", SEEN)
def test_a_mistake_that_shows(mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, words = SEEN[mistake]
    if mistake == "target that is too heavy":
        (tmp_path / "arm.py").write_text(
            ARM.replace(old, new).replace("target_qpos=(0.0, 0.0)", "target_qpos=(1.5, 0.0)")
        )
        said = complaint(capsys, "check", str(tmp_path / "arm.py"), "--out", str(tmp_path / "check.png"))
    else:
        said = check(tmp_path, capsys, old, new)
    assert one_sentence(said)
    assert words in said
    assert (tmp_path / "check.png").exists()


@pytest.mark.parametrize("change", ['<joint name="elbow" damping="100"', '<joint name="elbow" stiffness="1e6"'])
def test_a_simulation_that_diverges_is_one_sentence_without_a_log_of_mujoco_s(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.py").write_text(ARM.replace('<joint name="elbow"', change))
    said = complaint(capfd, "check", "arm.py")
    assert one_sentence(said)
    assert "The simulation diverged: joint 'elbow' of system 'arm' ran away; use smaller actions" in said
    said = complaint(capfd, "collect", "arm.py", "--episodes", "2", "--steps", "20", "--workers", "2", "--out", "data")
    assert one_sentence(said) and "The simulation diverged" in said
    assert not Path("MUJOCO_LOG.TXT").exists()


def test_other_commands_say_what_is_wrong_with_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.py").write_text(ARM)
    Path("free.py").write_text("from keycld_envs import Mechanism, Rod\nmechanism = Mechanism(1, 0, (Rod(None, 0),))\n")
    Path("my arm.py").write_text(ARM)
    Path("arm.xml").write_text('<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>')
    cases = {
        "arm.py": ("collect", "arm", "--out", "data"),
        "without a simulation": ("collect", "free.py", "--out", "data"),
        "letters, digits": ("collect", "my arm.py", "--out", "data"),
        "no Python file": ("collect", "nowhere.py", "--out", "data"),
        "--weights": ("swingup", "arm.py"),
        "does not exist": ("train", "arm.py", "--data", "nowhere", "--out", "runs"),
        "--data": ("check", "free.py"),
        ".png": ("check", "arm.py", "--out", "check.txt"),
        "exists": ("new", "arm"),
        "cannot be a name": ("new", "my arm"),
        "has no name": ("new", "other", "--mjcf", "arm.xml"),
        "hand in a MuJoCo XML file": ("new", "other", "--mjcf", "nowhere.xml"),
    }
    for words, command in cases.items():
        said = complaint(capsys, *command)
        assert one_sentence(said), said
        assert words in said
    assert not {"data", "runs", "other.py"} & {path.name for path in tmp_path.iterdir()}


@pytest.mark.render
@pytest.mark.parametrize("template", ["pendulum", "cartpole", "two_links"])
def test_what_keycld_new_writes_has_no_mistake(
    template: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "lab/thing", "--template", template, "--json"]) == 0
    assert main(["check", "lab/thing.py", "--json"]) == 0
    new, check = map(json.loads, capsys.readouterr().out.splitlines())
    assert new["file"] == check["system"] == "lab/thing.py"
    assert (check["problems"], check["warnings"]) == ([], [])
    assert Image.open("check.png").size[0] == 5 * 384


@pytest.mark.render
def test_recordings_are_compared_with_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, template in (("arm", "two_links"), ("pole", "pendulum"), ("film", "video")):
        assert main(["new", name, "--template", template]) == 0
    assert main(["collect", "arm.py", "--out", "data", "--episodes", "2", "--width", "16", "--height", "16"]) == 0
    capsys.readouterr()
    assert main(["check", "arm.py", "--data", "data"]) == 0
    assert "2 recordings of 50 frames are few" in capsys.readouterr().err
    assert "records arm.py, not pole.py" in complaint(capsys, "check", "pole.py", "--data", "data")
    assert "2 actions" in complaint(capsys, "check", "film.py", "--data", "data")
