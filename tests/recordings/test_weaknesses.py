"""What is said of recordings that are weak, and how their frames are cut; against recordings made so."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from keycld_control.cli import main
from keycld_envs import SYSTEMS, Mechanism, Rod
from keycld_envs.recordings import Dataset, Recording, read_dataset, write_recording
from keycld_envs.recordings.crop import cropped, moving_box, square, units_of
from keycld_envs.recordings.weaknesses import weaknesses


def dot(rows: NDArray[np.float64], columns: NDArray[np.float64], height: int, width: int) -> NDArray[np.uint8]:
    """[T, H, W, 3] a white dot of 4 x 4 pixels on black, its upper left corner at rows and columns [T]."""
    frames = np.zeros((len(rows), height, width, 3), np.uint8)
    for frame, row, column in zip(frames, rows.astype(int), columns.astype(int), strict=True):
        frame[row : row + 4, column : column + 4] = 255
    return frames


def recordings(
    number: int = 100, speed: float = 5.0, push: float = 1.0, swing: float = 1.0, size: tuple[int, int] = (32, 32)
) -> Dataset:
    """A dot that turns about the middle, `speed` in rad/s, with a frame every 0.02 s."""
    clock, made = np.linspace(0, 0.98, 50), []
    for i in range(number):
        angle = np.asarray(swing * (speed * clock + i), np.float64)
        rows, columns = 12 + 8 * np.sin(angle), 12 + 8 * np.cos(angle)
        made.append(
            Recording(
                id=f"run-{i:03d}",
                source="real",
                joint_names=("hinge",),
                actuator_names=("motor",),
                units={"qpos": ("rad",), "action": ("N m",)},
                t_action=clock[:-1],
                action=np.full((49, 1), push * (-1) ** i),
                t_state=clock,
                qpos=angle[:, None],
                t_frame=clock,
                frames=dot(rows, columns, *size),
            )
        )
    return Dataset(Path("data"), tuple(made))


def test_good_recordings_are_not_weak() -> None:
    assert list(weaknesses(recordings())) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"number": 20}, "few"),
        ({"speed": 50.0}, "a frame every 0.01 s"),  # 1 rad a frame, whatever the actions
        ({"push": 0.0}, "Actuator 'motor'"),
        ({"swing": 0.0}, "Nothing moves"),
    ],
)
def test_each_weakness_is_named_alone(change: dict[str, float], words: str) -> None:
    (said,) = weaknesses(recordings(**change))  # pyright: ignore[reportArgumentType]
    assert words in said


def test_one_rod_in_a_video_turns_about_its_pivot_and_slowly_enough() -> None:
    def said(pivot: tuple[float, float], speed: float = 5.0) -> list[str]:
        filmed = recordings(speed=speed)
        absent: dict[str, Any] = dict.fromkeys(("qpos", "t_state", "action", "t_action"))
        made = (replace(r, joint_names=(), actuator_names=(), units={}, **absent) for r in filmed.recordings)
        mechanism = Mechanism(1, 0, (Rod(None, 0),), pivot=pivot)
        return list(weaknesses(Dataset(filmed.folder, tuple(made)), None, mechanism))

    assert said((-0.16, 0.16)) == []  # the middle of the circle
    for pivot in ((0.5, 0.4), (3.0, 0.0)):
        (words,) = said(pivot)
        assert "does not turn about the pivot" in words and f"({pivot[0]:g}, {pivot[1]:g})" in words
    (words,) = said((-0.16, 0.16), speed=50.0)
    assert "a frame every 0.01 s" in words


def test_oblong_frames_are_named_with_a_square_to_keep() -> None:
    (said, few) = weaknesses(recordings(2, size=(32, 64)))
    assert "64x32 pixels are not square" in said and "--box" in said and "few" in few


def test_large_frames_are_named_before_they_are_stacked() -> None:
    large = recordings(2, size=(360, 640))
    said = next(weaknesses(large))
    left, top, right, bottom = map(int, said.split("--box ")[1].rstrip(".").split())
    assert "56 times" in said and (right - left, bottom - top) == (22, 22)  # 2 x 8, a dot of 4, a tenth
    assert left <= 4 and right >= 24 and top <= 4 and bottom >= 24


def test_strong_actions_are_told_from_a_slow_camera() -> None:
    slow, fast = recordings(60, speed=5.0, push=1.0), recordings(60, speed=50.0, push=4.0)
    both = [r for pair in zip(slow.recordings, fast.recordings, strict=True) for r in pair]
    named = tuple(Recording(**{**vars(r), "id": f"run-{i}"}) for i, r in enumerate(both))
    (said,) = weaknesses(Dataset(Path("data"), named))
    assert "--action-range 2" in said


def of_cartpole(qpos: NDArray[np.float64]) -> Dataset:
    """A hundred recordings of the same motion [50, 2], as if of the simulation."""
    clock = np.linspace(0, 0.49, 50)
    made = tuple(
        Recording(
            id=f"run-{i}",
            source="simulation",
            joint_names=("slider", "hinge_1"),
            actuator_names=("slide", "hinge_1"),
            units={"qpos": ("m", "rad"), "action": "N"},
            t_action=clock[:-1],
            action=np.full((49, 2), float(i)),
            t_state=clock,
            qpos=qpos,
            t_frame=clock,
            frames=np.zeros((50, 8, 8, 3), np.uint8),
        )
        for i in range(100)
    )
    return Dataset(Path("data"), made)


def test_a_keypoint_of_a_simulation_that_never_moves() -> None:
    still = np.stack([np.zeros(50), np.linspace(0, 3, 50)], axis=1)  # the cart stands, the pole turns
    (said,) = weaknesses(of_cartpole(still), SYSTEMS["cartpole"])
    assert "Keypoint 0 moves by 0.0 pixels" in said


def test_a_joint_that_runs_into_the_end_of_its_range() -> None:
    turning, free = np.linspace(0, 3, 50), SYSTEMS["cartpole"]
    stopped = replace(free, mjcf=str(free.mjcf).replace('limited="false"', 'limited="true"'))
    inside, beyond = (np.stack([reach * np.sin(turning), turning], axis=1) for reach in (1.7, 1.9))  # of 1.8 m
    assert not [*weaknesses(of_cartpole(inside), stopped), *weaknesses(of_cartpole(beyond), free)]
    (said,) = weaknesses(of_cartpole(beyond), stopped)
    assert "'slider' runs into the end of its range" in said and "100 % of the recordings" in said


def test_the_square_around_what_moves() -> None:
    frames = dot(np.array([100.0, 140.0]), np.array([200.0, 300.0]), 360, 640)
    assert moving_box(frames) == (200, 100, 304, 144)
    left, top, right, bottom = square((200, 100, 304, 144), 640, 360)
    assert right - left == bottom - top == round(1.1 * 104)
    assert (left + right, top + bottom) == pytest.approx((504, 244), abs=1)
    assert square((0, 0, 640, 50), 640, 360) == (140, 0, 500, 360)  # no wider than the image is high
    assert moving_box(frames[:1]) is None


def test_keypoints_stay_where_they_are_seen() -> None:
    rows, columns = np.full(2, 40.0), np.array([60.0, 80.0])
    clock = np.array([0.0, 0.1])
    keypoints = np.stack([columns + 1.5, rows + 1.5], axis=1)[:, None]  # the middle of four pixels
    before = Recording(id="run", source="real", t_frame=clock, frames=dot(rows, columns, 128, 128), keypoints=keypoints)
    after = cropped(before, (32, 16, 96, 80), 32)
    assert after.frames is not None and after.keypoints is not None
    for frame, (column, row) in zip(after.frames, after.keypoints[:, 0], strict=True):
        light = frame[..., 0].astype(float)
        seen = (light.sum(axis=0) @ np.arange(32), light.sum(axis=1) @ np.arange(32)) / light.sum()
        assert seen == pytest.approx((column, row))
    assert before.keypoints is not None
    factors, shifts = units_of((32, 16, 96, 80), 128, 128, 32)
    old, new = before.keypoints[:, 0] / 63.5 - 1, after.keypoints[:, 0] / 15.5 - 1
    np.testing.assert_allclose(new * [1, -1], old * [1, -1] * np.array(factors) + shifts, atol=1e-9)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for recording in recordings(2, size=(36, 64)).recordings:
        write_recording(tmp_path / "data" / recording.id, recording)
    out = tmp_path / "small"
    assert main(["crop", str(tmp_path / "data"), "--out", str(out), "--size", "16", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["box"][2] <= 36 and len(said["factors"]) == len(said["shifts"]) == 2
    read = read_dataset(out)
    assert read.sequences().frames.shape == (2, 50, 16, 16, 3)
    assert read.recordings[0].qpos is not None and math.isclose(read.recordings[0].qpos[1, 0], 0.1)
    assert main(["crop", str(tmp_path / "data"), "--out", str(out)]) == 2
    assert main(["crop", str(tmp_path / "data"), "--out", str(tmp_path / "b"), "--box", "0", "0", "9", "99"]) == 2
    assert capsys.readouterr().err.count("\n") == 2
    assert main(["crop", str(tmp_path / "data"), "--out", str(tmp_path / "c"), "--size", "63"]) == 2
    assert "--size is 63" in capsys.readouterr().err
    assert main(["crop", str(tmp_path / "data"), "--out", str(tmp_path / "c")]) == 0
    assert "pivot=(x, y) is (" in capsys.readouterr().out
