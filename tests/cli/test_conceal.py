"""`keycld conceal`: what it writes, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from keycld_control.cli import main
from keycld_envs.collect import action_range_of
from keycld_envs.recordings import Recording, read_dataset, write_recording
from keycld_envs.systems import get_system

T = 0.01 * np.arange(150, dtype=np.float64)
FRICTION = ("--effect", "viscous_friction", "--at", "hinge")


@pytest.fixture
def data(tmp_path: Path) -> str:
    """Two recordings of a pendulum that swings by sines, with commands of zero."""
    for name in ("a", "b"):
        recording = Recording(
            id=name,
            source="simulation",
            system="KeyCLD/Pendulum-v0",
            joint_names=("hinge",),
            actuator_names=("motor",),
            units={"action": "1", "qpos": "rad"},
            t_action=T,
            action=np.zeros((len(T), 1)),
            t_state=T,
            qpos=np.sin(4 * T)[:, None],
        )
        write_recording(tmp_path / "data" / name, recording)
    return str(tmp_path / "data")


def test_commands_hide_friction_in_the_recordings_that_were_named(
    data: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["conceal", data, *FRICTION, "--set", "b=0.2", "--only", "b", "--out", str(out), "--json"]) == 0
    truth = json.loads((out / "concealed.json").read_text())
    assert truth == json.loads(capsys.readouterr().out)
    assert (truth["effect"], truth["parameters"], truth["recordings"]) == ("viscous_friction", {"b": 0.2}, ["b"])
    as_it_was, concealed = read_dataset(out).recordings
    gear, speed = get_system("pendulum").compile().actuator_gear[0, 0], 4 * np.cos(4 * T)
    assert truth["hidden_rms"]["hinge"] == pytest.approx(0.2 * np.sqrt(np.mean(speed**2)), rel=0.05)
    assert not np.any(as_it_was.action)
    inside = slice(10, -10)  # positions are made smooth to see speeds, worst at the ends
    assert np.asarray(concealed.action)[inside, 0] == pytest.approx(0.2 * speed[inside] / gear, abs=0.05)
    assert np.array_equal(np.asarray(concealed.qpos), np.asarray(as_it_was.qpos))


def test_a_base_that_is_not_level(data: str, tmp_path: Path) -> None:
    out, model = tmp_path / "out", get_system("pendulum").compile()
    tilt = ("--effect", "gravity_tilt", "--at", "world", "--set", "alpha=0.1")
    assert main(["conceal", data, *tilt, "--out", str(out)]) == 0
    (concealed, _), q = read_dataset(out).recordings, np.sin(4 * T)
    link = model.body_mass[-1] * model.body_ipos[-1, 2] * 9.81
    turned = link * (np.sin(q) - np.sin(q - 0.1))  # gravity that is turned is an angle that is counted from elsewhere
    hidden = model.actuator_gear[0, 0] * np.asarray(concealed.action)[10:-10, 0]
    assert np.abs(hidden) == pytest.approx(np.abs(turned)[10:-10], abs=0.02 * link)


def test_motors_keep_the_range_that_they_were_recorded_with(
    data: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    # Motors that give .01 of their gear at most, less than hides this much friction.
    (Path(data) / "collect.json").write_text(json.dumps({"action_range": 0.01}))
    assert main(["conceal", data, *FRICTION, "--set", "b=0.2", "--out", str(tmp_path / "no")]) == 2  # beyond .01
    assert main(["conceal", data, *FRICTION, "--set", "b=0.00001", "--out", str(out)]) == 0
    assert action_range_of(out) == 0.01
    assert main(["collect", "pendulum", "--out", str(out)]) == 2
    assert "was not made by `keycld collect`" in capsys.readouterr().err


def test_all_recordings_by_default_and_a_table(data: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["conceal", data, *FRICTION, "--set", "b=0.2", "--out", str(out)]) == 0
    assert all(np.any(r.action) for r in read_dataset(out).recordings)
    assert "viscous_friction at hinge" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words, named",
    [
        (("--effect", "glue", "--at", "hinge"), "'glue'"),
        (("--effect", "viscous_friction", "--at", "knee"), "'knee'"),
        ((*FRICTION, "--set", "c=0.1"), "'c'"),
        ((*FRICTION, "--set", "b=much"), "b=much"),
        ((*FRICTION, "--set", "b"), "'b'"),
        (FRICTION, "--set b=NUMBER"),
        ((*FRICTION, "--set", "b=-1"), "b=-1"),
        ((*FRICTION, "--set", "b=0.1", "--only", "c"), "'c'"),
        (("--effect", "end_stop", "--at", "hinge", "--set", "at=0.5"), "does nothing in these recordings"),
        (("--effect", "constant_force", "--at", "hinge", "--set", "f=40"), "beyond its range of -3 to 3"),
        (("--effect", "added_inertia", "--at", "hinge", "--set", "i=0.1"), "a simulator in which it is another"),
    ],
)
def test_what_cannot_be_concealed_is_refused_by_name(
    data: str, words: tuple[str, ...], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["conceal", data, *words, "--out", str(tmp_path / "out")]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_is_there_already_stays(data: str, tmp_path: Path) -> None:
    before = sorted(p.name for p in Path(data).iterdir())
    assert main(["conceal", data, *FRICTION, "--set", "b=0.2", "--out", data]) == 2
    assert sorted(p.name for p in Path(data).iterdir()) == before
