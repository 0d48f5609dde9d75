"""Data sets from videos: what is kept, when it was taken, and where it was in the video."""

import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from keycld_control.cli import main
from keycld_envs import InputError
from keycld_envs.recordings import read_dataset
from keycld_envs.recordings.importers.film import Cut, Square, look_at, square_around, write_parts
from keycld_envs.recordings.video import write_video

SIZE, RATE, COUNT, PIVOT, LENGTH = (200, 120), 25, 60, (90.0, 20.0), 60.0
ANGLES = 1.2 * np.sin(0.2 * np.arange(COUNT))


def bob(i: int) -> tuple[float, float]:
    """Column and row of the weight in frame i, pixels."""
    return PIVOT[0] + LENGTH * float(np.sin(ANGLES[i])), PIVOT[1] + LENGTH * float(np.cos(ANGLES[i]))


def picture(i: int) -> np.ndarray:
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    away = np.hypot(columns - bob(i)[0], rows - bob(i)[1])
    light = 100 + 150 * np.exp(-((away / 5) ** 2))
    return np.repeat(light[:, :, None], 3, axis=2).astype(np.uint8)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "swing.mkv"
    write_video(path, (picture(i) for i in range(COUNT)), SIZE, RATE)
    return path


def no_progress(steps: int = 1, note: str | None = None) -> None:
    pass


def test_the_weight_is_where_it_was_filmed(video: Path, tmp_path: Path) -> None:
    look = look_at(video)
    square = square_around(look, (0.0, 0.6), PIVOT)
    assert square.units(*PIVOT) == pytest.approx((0.0, 0.6), abs=1.001 / (square.side - 1))
    assert write_parts(video, tmp_path / "data", look, square, no_progress, Cut(size=40, frames=20)) == 3
    data = read_dataset(tmp_path / "data")
    for number, recording in enumerate(data.recordings):
        frames = recording.load_frames().astype(float)
        assert frames.shape == (20, 40, 40, 3)
        for k in (0, 19):
            light = np.clip(frames[k, :, :, 0] - 100, 0, None)
            rows, columns = np.mgrid[:40, :40]
            found = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
            expected = (np.array(bob(20 * number + k)) - (square.left, square.top) + 0.5) * 40 / square.side - 0.5
            assert found == pytest.approx(expected, abs=0.1)
    assert data.sequences().timestep == pytest.approx(1 / RATE)
    assert data.recordings[0].camera is not None
    assert data.recordings[0].camera["crop"] == [square.left, square.top, square.side]


def test_all_that_moves_is_kept(video: Path) -> None:
    square = square_around(look_at(video))
    points = np.array([bob(i) for i in range(COUNT)])
    assert (points - 6 > (square.left, square.top)).all() and (
        points + 6 < np.add(square.side, (square.left, square.top))
    ).all()
    assert square.side < 1.4 * np.ptp(points[:, 0]) + 12


def test_pixels_and_image_units_are_inverse() -> None:
    square = Square(-7, 12, 101)
    assert square.units(-7, 12) == (-1.0, 1.0)
    assert square.pixel(*square.units(33.25, 60.5)) == pytest.approx((33.25, 60.5))


@pytest.mark.parametrize(
    "square, share",
    [((0, 0, 80), 1.0), ((-40, 60, 80), 0.375), ((160, 0, 10), 0.0), ((-100, 0, 90), 0.0), ((0, 0, 0), 0.0)],
)
def test_how_much_of_a_square_is_video(square: tuple[int, int, int], share: float) -> None:
    assert Square(*square).share_within((160, 120)) == share


def test_a_recording_ends_where_frames_were_left_out(video: Path, tmp_path: Path) -> None:
    look = look_at(video)
    times = look.times.copy()
    times[25:] += 0.1  # two and a half frames are missing
    gap = type(look)(look.size, times, look.moving)
    write_parts(video, tmp_path / "data", gap, Square(0, 0, 120), no_progress, Cut(size=16, frames=10))
    starts = [float(recording.notes.split(" s")[0]) for recording in read_dataset(tmp_path / "data").recordings]
    assert starts == pytest.approx([0.0, 0.4, 1.1, 1.5, 1.9])


def test_every_other_frame(video: Path, tmp_path: Path) -> None:
    write_parts(video, tmp_path / "data", look_at(video), Square(0, 0, 120), no_progress, Cut(frames=30, every=2))
    assert read_dataset(tmp_path / "data").sequences().timestep == pytest.approx(2 / RATE)


MECHANISM = "from keycld_envs import Mechanism, Rod\nmechanism = Mechanism(1, 0, (Rod(None, 0),), pivot=(0.0, 0.5))\n"


def test_from_the_command_line(video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    declared = tmp_path / "pendulum.py"
    declared.write_text(MECHANISM)
    args = ["import", str(video), "--out", str(tmp_path / "data"), "--mechanism", str(declared)]
    assert main(args) == 2
    assert "--pivot COLUMN ROW" in capsys.readouterr().err
    driven = tmp_path / "driven.py"
    driven.write_text(MECHANISM.replace("(1, 0,", "(1, 2,"))
    assert main([*args[:-1], str(driven), "--pivot", "90", "20"]) == 2
    assert "driven.py declares num_actions=2, but a video tells of no actions" in capsys.readouterr().err
    assert main([*args, "--pivot", "90", "20", "--crop", "60", "0", "60"]) == 2
    assert "--crop puts the pivot at (0.017, 0.322), but" in capsys.readouterr().err
    assert main([*args, "--pivot", "90", "20", "--frames", "20", "--json"]) == 0
    captured = capsys.readouterr()
    assert '"recordings": 3' in captured.out and captured.err == ""
    args[3] = str(tmp_path / "outside")
    assert main([*args, "--pivot", "90", "-20"]) == 0
    err = capsys.readouterr().err
    assert "warning: --pivot 90 -20 lies outside" in err and "of the square" not in err
    args[3] = str(tmp_path / "mostly border")
    assert main([*args, "--pivot", "90", "20", "--crop", "-80", "-65", "340"]) == 0
    assert "200x120 pixels, covers 21% of the square that is kept, -80 -65 340;" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, word",
    [
        (["--crop", "500", "0", "50"], "--crop 500 0 50 shows nothing of"),
        (["--crop", "0", "0", "0"], "--crop 0 0 0 shows nothing of"),
        (["--frames", "600"], "--frames"),
        (["--frames", "1"], "--frames"),
        (["--fps", "0"], "--fps"),
        (["--every", "0"], "--every"),
        (["--size", "2"], "--size"),
        (["--size", "100000"], "--size"),
        (["--crop", "0", "0", "100000"], "--crop must be 8192"),
        (["--pivot", "nan", "20"], "--pivot is nan 20"),
        (["--pivot", "9000", "9000"], "--pivot 9000 9000 is far from all that moves"),
        (["--time", "t"], "leave --time out"),
    ],
)
def test_mistakes_are_told(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], word: str
) -> None:
    assert main(["import", str(video), "--out", str(tmp_path / "data"), *options]) == 2
    assert word in capsys.readouterr().err
    assert not (tmp_path / "data").exists()


def test_a_video_in_which_nothing_moves(tmp_path: Path) -> None:
    path = tmp_path / "still.mkv"
    write_video(path, (picture(0) for _ in range(12)), SIZE, RATE)
    with pytest.raises(InputError, match="--crop"):
        square_around(look_at(path))


def test_a_truncated_video(video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    assert main(["import", str(cut), "--out", str(tmp_path / "data")]) == 2
    assert "cut.mkv" in capsys.readouterr().err


def test_an_uneven_rate_is_told_with_the_longest_run(video: Path, tmp_path: Path) -> None:
    look = look_at(video)
    times = np.cumsum(np.where(np.arange(COUNT) % 7 == 0, 0.1, 1 / RATE))
    with pytest.raises(InputError, match=r"7 in a row at most\); film for longer and at a fixed rate"):
        write_parts(video, tmp_path / "data", type(look)(look.size, times, look.moving), Square(0, 0, 120), no_progress)


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.mp4", b"", "(it is empty)"),
        ("a.mp4", b"no video at all", "(it is cut short, or no MP4)"),
        ("a.png", b"no video either", "a.png is no video by its name"),
    ],
)
def test_what_is_no_video(
    name: str, content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(content)
    assert main(["import", str(tmp_path / name), "--out", str(tmp_path / "data"), "--frames", "20"]) == 2
    assert words in capsys.readouterr().err


def test_a_file_of_sound_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sound = tmp_path / "sound.mp4"
    made = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-f", "lavfi", "-i", "sine=duration=1", str(sound)]
    subprocess.run(made, check=True)
    assert main(["import", str(sound), "--out", str(tmp_path / "data")]) == 2
    assert "sound.mp4 cannot be decoded as a video (it holds no pictures)" in capsys.readouterr().err
