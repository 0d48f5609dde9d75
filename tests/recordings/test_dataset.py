"""Data sets: what is loaded, how it is divided, hashed and stacked."""

import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keycld_envs.errors import InputError
from keycld_envs.recordings import Dataset, Recording, read_dataset, write_recording

Make = Callable[..., Recording]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, make_recording: Make) -> Path:
    data = tmp_path_factory.mktemp("written") / "data"
    for i in range(20):
        write_recording(data / f"run-{i:02d}", make_recording(i), video=i % 2 == 1)
    (data / "notes.txt").touch()
    (data / ".run-20.partial").mkdir()
    return data


@pytest.fixture
def folder(tmp_path: Path, written: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "data"))


def test_reading_in_order(folder: Path) -> None:
    data = read_dataset(folder)
    assert [r.id for r in data.recordings] == [f"run-{i:02d}" for i in range(20)]
    assert data.system == "KeyCLD/Cartpole-v0"
    assert data.damaged == ()


@pytest.mark.parametrize("count", [2, 3, 9, 10, 11, 500])
def test_split_is_complete_disjoint_and_stable(make_recording: Make, count: int) -> None:
    recording = make_recording()
    data = Dataset(Path(), tuple(replace(recording, id=f"{i}") for i in range(count)))
    training, validation = data.split()
    names = [r.id for r in training.recordings], [r.id for r in validation.recordings]
    assert sorted(names[0] + names[1], key=int) == [r.id for r in data.recordings]
    assert len(validation) == max(1, count // 10)
    if count == 500:
        smaller = replace(data, recordings=data.recordings[:250])
        assert [r.id for r in smaller.split()[1].recordings] == names[1][:25]


def test_split_refuses_the_impossible(make_recording: Make) -> None:
    one = Dataset(Path("data"), (make_recording(),))
    with pytest.raises(InputError, match="holds one recording"):
        one.split()
    with pytest.raises(InputError, match="no recording for training"):
        Dataset(Path("data"), (make_recording(), make_recording(1))).split(1.0)


def test_hash_follows_content_only(tmp_path: Path, make_recording: Make, folder: Path) -> None:
    recordings = [make_recording(i) for i in range(20)]
    assert read_dataset(folder).sha256 == Dataset(tmp_path, tuple(recordings)).sha256
    hashes = {Dataset(tmp_path, (recordings[0],)).sha256}
    for change in (
        {"id": "other"},
        {"system": None},
        {"qvel": None},
        {"action": recordings[1].action},
        {"frames": recordings[1].frames},
    ):
        hashes.add(Dataset(tmp_path, (replace(recordings[0], **change),)).sha256)
    assert len(hashes) == 6


def test_sequences_are_the_recorded_arrays(folder: Path, make_recording: Make) -> None:
    sequences = read_dataset(folder).sequences()
    assert sequences.frames.shape == (20, 8, 10, 12, 3)
    assert sequences.actions.shape == (20, 7, 1)
    assert sequences.qpos is not None
    assert sequences.qpos.shape == (20, 8, 2)
    assert sequences.timestep == pytest.approx(0.01)
    for i in (0, 19):
        recording = make_recording(i)
        np.testing.assert_array_equal(sequences.frames[i], recording.frames)
        assert recording.action is not None
        assert recording.qpos is not None
        np.testing.assert_allclose(sequences.actions[i], recording.action, atol=1e-12)
        np.testing.assert_allclose(sequences.qpos[i], recording.qpos, atol=1e-12)


def test_other_clocks_keep_impulse_and_line(make_recording: Make) -> None:
    recording = make_recording(
        t_action=np.array([-0.5, 0.015, 0.025]),
        action=np.array([[1.0], [3.0], [0.0]]),
        t_state=np.array([0.0, 0.03, 0.06]),
        qpos=np.array([[0.0, 0.0], [3.0, np.nan], [6.0, 6.0]]),
        qvel=None,
    )
    sequences = Dataset(Path(), (recording,)).sequences()
    np.testing.assert_allclose(sequences.actions[0, :, 0], [1, 2, 1.5, 0, 0, 0, 0], atol=1e-12)
    assert sequences.qpos is not None
    np.testing.assert_allclose(sequences.qpos[0, :, 0], [0, 1, 2, 3, 4, 5, 6, np.nan], atol=1e-12)
    assert np.isnan(sequences.qpos[0, 1:6, 1]).all()


def test_without_actions_and_positions(make_recording: Make) -> None:
    bare: dict[str, Any] = dict.fromkeys(("t_action", "action", "t_state", "qpos", "qvel"))
    sequences = Dataset(Path(), (make_recording(**bare, actuator_names=()),)).sequences()
    assert sequences.actions.shape == (1, 7, 0)
    assert sequences.qpos is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_frames": 9}, "run-01 has 9 frames of 12×10 pixels, but run-00 has 8"),
        ({"frames": np.zeros((8, 4, 4, 3), np.uint8), "camera": None}, "8 frames of 4×4 pixels"),
        ({"t_frame": 0.02 * np.arange(8)}, "a frame every 0.02 s, but run-00 every 0.01 s"),
        ({"t_frame": np.array([0, 1, 2, 3, 5, 6, 7, 8.0])}, "frames 3 and 4 are 2 s apart, others 1 s"),
        ({"t_frame": np.zeros(8)}, "frames 0 and 1 are 0 s apart"),
        ({"t_action": 0.005 + 0.01 * np.arange(7)}, "t_action starts at 0.005 s, after the first frame"),
        ({"actuator_names": ("hinge",)}, "different joints or actuators"),
        ({"t_action": None, "action": None}, "some recordings have no actions"),
        ({"t_frame": None, "frames": None}, "has no frames"),
    ],
)
def test_recordings_that_do_not_stack(make_recording: Make, changes: dict[str, Any], message: str) -> None:
    data = Dataset(Path("data"), (make_recording(), make_recording(1, **changes)))
    with pytest.raises(InputError, match=message):
        data.sequences()


def test_mixed_systems_are_named(make_recording: Make) -> None:
    data = Dataset(Path("data"), (make_recording(), make_recording(1, system=None)))
    with pytest.raises(InputError, match="mixes recordings of KeyCLD/Cartpole-v0 and None"):
        _ = data.system


def test_damage_is_refused_or_skipped_with_a_warning(folder: Path) -> None:
    path = folder / "run-04" / "frames.npz"
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match=r"run-04.frames.npz"):
        read_dataset(folder)
    with pytest.warns(UserWarning, match=r"Skipped: .*run-04"):
        data = read_dataset(folder, skip_damaged=True)
    assert len(data) == 19
    assert len(data.damaged) == 1
    assert str(path) in data.damaged[0]


def test_unusable_folders(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match="does not exist; `keycld collect`"):
        read_dataset(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file is a file; name a folder of recordings"):
        read_dataset(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no recordings"):
        read_dataset(tmp_path / "empty")
    with pytest.raises(InputError, match="is one recording; name the folder that holds it"):
        read_dataset(folder / "run-00")
    (tmp_path / "empty" / "a").mkdir()
    with pytest.raises(InputError, match=r"meta.json is missing"):
        read_dataset(tmp_path / "empty")
    with warnings.catch_warnings(), pytest.raises(InputError, match="only damaged recordings"):
        warnings.simplefilter("ignore")
        read_dataset(tmp_path / "empty", skip_damaged=True)
    (folder / "run-00").rename(folder / "run-00-copy")
    write_recording(folder / "run-00", read_dataset(folder).recordings[0])
    with pytest.raises(InputError, match="two recordings with the id 'run-00'"):
        read_dataset(folder)
