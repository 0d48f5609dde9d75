"""What is written is what is read, and damage is named by file, key, shape and index."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, read_recording, write_recording
from keycld_envs.recordings.storage import META
from keycld_envs.recordings.validation import SIGNALS

Make = Callable[..., Recording]


def assert_same(a: Recording, b: Recording) -> None:
    for name in META:
        assert getattr(a, name) == getattr(b, name), name
    for name in SIGNALS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    if a.num_frames:
        np.testing.assert_array_equal(a.load_frames(), b.load_frames())


@pytest.mark.parametrize("video", [False, True])
def test_round_trip_keeps_every_bit(tmp_path: Path, make_recording: Make, video: bool) -> None:
    recording = make_recording()
    write_recording(tmp_path / "a", recording, video=video)
    assert {p.name for p in (tmp_path / "a").iterdir()} == {
        "meta.json",
        "signals.npz",
        "frames.mkv" if video else "frames.npz",
    }
    back = read_recording(tmp_path / "a")
    assert_same(recording, back)
    assert [f.shape for f in back.iter_frames()] == [(10, 12, 3)] * 8


def test_missing_samples_and_raw_clocks_survive(tmp_path: Path, make_recording: Make) -> None:
    qpos = np.array([[0.0, 1.0], [np.nan, np.nan], [0.2, 9.0]])
    recording = make_recording(t_state=np.array([-1.0, 5.0, 5.0]), qpos=qpos, qvel=None)
    write_recording(tmp_path / "a", recording)
    assert_same(recording, read_recording(tmp_path / "a"))


def test_states_without_frames_and_frames_without_states(tmp_path: Path, make_recording: Make) -> None:
    blind = make_recording(t_frame=None, frames=None, camera=None)
    film = make_recording(t_state=None, qpos=None, qvel=None, t_action=None, action=None)
    for name, recording in (("blind", blind), ("film", film)):
        write_recording(tmp_path / name, recording)
        assert_same(recording, read_recording(tmp_path / name))


def test_a_camera_file_stays_untouched(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording()
    write_recording(tmp_path / "source", recording, video=True)
    camera_file = tmp_path / "IMG_1.MOV"
    os.rename(tmp_path / "source" / "frames.mkv", camera_file)
    write_recording(tmp_path / "a", replace(recording, frames=None, video=camera_file))
    assert (tmp_path / "a" / "original.mov").read_bytes() == camera_file.read_bytes()
    assert_same(recording, read_recording(tmp_path / "a"))


def test_an_existing_recording_is_not_overwritten(tmp_path: Path, make_recording: Make) -> None:
    write_recording(tmp_path / "a", make_recording())
    with pytest.raises(InputError, match="exists already"):
        write_recording(tmp_path / "a", make_recording(1))
    assert read_recording(tmp_path / "a").id == "run-00"


def test_a_failed_write_leaves_nothing(tmp_path: Path, make_recording: Make) -> None:
    with pytest.raises(TypeError):
        write_recording(tmp_path / "a", make_recording(camera={"width": 12, "height": 10, "pose": object()}))
    assert list(tmp_path.iterdir()) == []


def test_a_write_killed_in_the_middle_leaves_no_recording_and_is_repeated(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from keycld_envs.files import atomic_folder\n"
        "with atomic_folder(sys.argv[1]) as folder:\n"
        "    (folder / 'meta.json').write_text('{}')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path / "a")], check=False).returncode == -9
    assert not (tmp_path / "a").exists()
    from keycld_envs.files import atomic_folder

    with atomic_folder(tmp_path / "a") as folder:
        assert list(folder.iterdir()) == []
        (folder / "signals").touch()
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"action": np.array([[0.0]] * 3 + [[np.nan]] + [[0.0]] * 3)}, r"signals.npz: action\[3, 0\] is nan"),
        ({"action": np.zeros(7)}, r"action has shape \[7\]"),
        ({"action": np.zeros((7, 2))}, "action has 2 columns, but meta.json names 1 actuator_names"),
        ({"action": np.zeros((5, 1))}, "action has 5 rows, but t_action has 7"),
        ({"t_action": None}, "action has no clock"),
        ({"action": None}, "t_action stands without action"),
        ({"qpos": np.full((8, 2), np.inf)}, r"qpos\[0, 0\] is inf"),
        ({"qpos": np.zeros((8, 2), np.float32)}, "qpos is float32; it must be a float64"),
        ({"qpos": np.zeros((8, 2)).tolist()}, "qpos is list"),
        ({"qpos": None, "qvel": None}, "t_state stands without"),
        ({"qpos": None, "qvel": None, "t_state": None, "t_frame": None, "frames": None}, "neither frames nor qpos"),
        ({"t_frame": np.array([0.0, 1, 2, 3, 2.5, 5, 6, 7])}, r"t_frame\[4\] = 2.5 s comes after 3 s"),
        ({"t_frame": np.full(8, np.nan)}, r"t_frame\[0\] is nan"),
        ({"t_frame": np.arange(7.0)}, "frames has 8 frames, but t_frame has 7"),
        ({"t_frame": np.array([])}, "t_frame is empty"),
        ({"t_frame": None}, "frames have no clock"),
        ({"qpos": None, "qvel": None, "t_state": None, "t_frame": None}, "frames have no clock"),
        ({"frames": None}, "lists 8 frames, but no frames are stored"),
        ({"frames": np.zeros((8, 10, 12), np.uint8)}, r"frames.npz: frames has shape \[8, 10, 12\]"),
        ({"frames": np.zeros((8, 10, 12, 4), np.uint8)}, r"it must be \[T, H, W, 3\]"),
        ({"frames": np.zeros((8, 10, 12, 3))}, "frames is float64; it must be a uint8"),
        ({"frames": np.zeros((8, 12, 10, 3), np.uint8)}, "frames is 10×12 pixels, but camera in meta.json says 12×10"),
        ({"id": ""}, "meta.json: id is empty"),
        ({"source": "film"}, "source is 'film'"),
        ({"licence": None}, "licence is None"),
        ({"joint_names": ("a", "a")}, "the same name twice"),
        ({"joint_names": ("a",)}, "qpos has 2 columns, but meta.json names 1 joint_names"),
        ({"units": {"action": "N", "qpos": "rad"}}, "qvel has no unit"),
        ({"units": {"action": "N", "qpos": ("rad",), "qvel": "rad/s"}}, "units.qpos in meta.json has 1"),
        ({"camera": {"width": 12}}, "camera.height is None"),
        ({"camera": 12}, "camera is 12"),
        ({"units": "rad"}, "units is 'rad'"),
        ({"seed": True}, "seed is True"),
        ({"system": 3}, "system is 3"),
        ({"system": ""}, "meta.json: system is empty"),
    ],
)
def test_a_wrong_recording_cannot_be_made(make_recording: Make, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_recording(**changes)


@pytest.fixture
def stored(tmp_path: Path, make_recording: Make) -> Path:
    write_recording(tmp_path / "a", make_recording())
    return tmp_path / "a"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": "keycld.recording/2"}, "meta.json: schema is 'keycld.recording/2'; this version of keycld reads"),
        ({"schema": ...} | {"extra": 1}, "schema is None"),
        ({"units": {}}, "signals.npz: action has no unit"),
        ({"colour": "red"}, "field 'colour' is unknown"),
        ({"camera": {"width": 64, "height": 64}}, "frames.npz: frames is 12×10 pixels"),
        ({"joint_names": "hinge"}, "joint_names is 'hinge'"),
    ],
)
def test_wrong_meta_is_refused(stored: Path, changes: dict[str, Any], message: str) -> None:
    meta = json.loads((stored / "meta.json").read_text()) | changes
    meta = {name: value for name, value in meta.items() if value is not ...}
    (stored / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match=message) as caught:
        read_recording(stored)
    assert str(stored) in str(caught.value)


@pytest.mark.parametrize("name", ["signals.npz", "frames.npz"])
@pytest.mark.parametrize("damage", ["truncate", "flip", "text", "empty", "npy", "pickle"])
def test_damaged_arrays_are_refused(stored: Path, name: str, damage: str) -> None:
    path = stored / name
    data = path.read_bytes()
    if damage == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    elif damage == "pickle":
        key = "frames" if name == "frames.npz" else "qpos"
        arrays: dict[str, Any] = {key: np.array([{"a": 1}], object)}
        np.savez(path, **arrays)
    else:
        middle = len(data) // 3
        path.write_bytes(
            {
                "truncate": data[: 2 * middle],
                "flip": data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :],
                "text": b"no npz",
                "empty": b"",
            }[damage]
        )
    with pytest.raises(InputError) as caught:
        read_recording(stored)
    assert str(path) in str(caught.value)


def test_every_flipped_byte_is_noticed_or_harmless(stored: Path) -> None:
    """A reader of a damaged file raises InputError or returns the original, nothing else."""
    original = read_recording(stored)
    rng = np.random.default_rng(0)
    for name in ("signals.npz", "frames.npz", "meta.json"):
        data = (stored / name).read_bytes()
        for position in rng.integers(0, len(data), 60):
            flipped = bytearray(data)
            flipped[position] ^= 1 << int(rng.integers(8))
            (stored / name).write_bytes(flipped)
            try:
                back = read_recording(stored)
            except InputError:
                continue
            if name != "meta.json":
                assert_same(original, back)
        (stored / name).write_bytes(data)


def test_missing_files_and_keys(stored: Path) -> None:
    frames = (stored / "frames.npz").read_bytes()
    np.savez(stored / "frames.npz", images=np.zeros((8, 10, 12, 3), np.uint8))
    with pytest.raises(InputError, match="key 'images' is unknown"):
        read_recording(stored)
    np.savez(stored / "frames.npz")
    with pytest.raises(InputError, match="'frames' is missing"):
        read_recording(stored)
    (stored / "frames.npz").unlink()
    with pytest.raises(InputError, match="no frames are stored"):
        read_recording(stored)
    (stored / "frames.npz").write_bytes(frames)
    (stored / "original.mp4").touch()
    with pytest.raises(InputError, match=r"both frames.npz and original.mp4"):
        read_recording(stored)
    (stored / "original.mp4").unlink()
    (stored / "signals.npz").unlink()
    with pytest.raises(InputError, match=r"signals.npz is missing"):
        read_recording(stored)
    (stored / "meta.json").write_text("{")
    with pytest.raises(InputError, match=r"meta.json is not readable JSON"):
        read_recording(stored)
    (stored / "meta.json").unlink()
    with pytest.raises(InputError, match=r"meta.json is missing"):
        read_recording(stored)
    with pytest.raises(InputError, match="is not a folder"):
        read_recording(stored / "nowhere")


@pytest.mark.parametrize("damage", ["truncate", "flip", "text", "extra"])
def test_damaged_videos_are_refused(tmp_path: Path, make_recording: Make, damage: str) -> None:
    write_recording(tmp_path / "a", make_recording(num_frames=30), video=True)
    path = tmp_path / "a" / "frames.mkv"
    data = path.read_bytes()
    if damage == "extra":
        write_recording(tmp_path / "b", make_recording(num_frames=31), video=True)
        path.write_bytes((tmp_path / "b" / "frames.mkv").read_bytes())
    else:
        middle = len(data) // 2
        path.write_bytes(
            {
                "truncate": data[:middle],
                "flip": data[:middle] + bytes(255 - b for b in data[middle : middle + 20]) + data[middle + 20 :],
                "text": b"no video",
            }[damage]
        )
    with pytest.raises(InputError) as caught:
        read_recording(tmp_path / "a")
    assert str(path) in str(caught.value)


def test_reading_part_of_a_video_ends_its_decoder(tmp_path: Path, make_recording: Make) -> None:
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    if not children.exists():
        pytest.skip("this kernel does not list the children of a process")
    write_recording(tmp_path / "a", make_recording(num_frames=30), video=True)
    recording = read_recording(tmp_path / "a")
    before = children.read_text()
    for _ in recording.iter_frames():
        assert children.read_text() != before
        break
    assert children.read_text() == before


@pytest.mark.parametrize("name", ["../../elsewhere", "a/b", "..", ".hidden", "a\\b", "a\0b"])
def test_an_id_is_the_name_of_a_folder_and_leads_to_no_other(name: str) -> None:
    signals = {"t_state": np.arange(3.0), "qpos": np.zeros((3, 1)), "units": {"qpos": "rad"}, "joint_names": ("hinge",)}
    with pytest.raises(InputError, match="leave out slashes"):
        Recording(id=name, source="real", **signals)
    with pytest.raises(InputError, match=r"qpos_std\[1, 0\] is -1"):
        Recording(id="run", source="real", qpos_std=np.array([[1.0], [-1.0], [1.0]]), **signals)
