"""Videos with known motion: places, angles and lengths come back, and what is missing is said to be."""

import json
from pathlib import Path

import numpy as np
import pytest
from scenes import CAMERA, draw_chain, draw_pendulum, nothing, swing
from scipy.ndimage import gaussian_filter

from keycld_control.cli import main
from keycld_control.tracking.summary import doubts
from keycld_envs import Mechanism, Rod
from keycld_envs.recordings import read_recording
from keycld_envs.recordings.video import decode, write_video
from keycld_model.tracking import read, track
from keycld_model.tracking.pendulum import study_pendulum

PENDULUM = Mechanism(num_keypoints=1, num_actions=0, rods=(Rod(None, 0),))


EXAMPLE = Path(__file__).parents[2] / "examples" / "apple_pendulum.py"
TWO_LINKS = Mechanism(num_keypoints=2, num_actions=0, rods=(Rod(None, 0), Rod(0, 1)))
DOUBLE = "from keycld_envs import Mechanism, Rod\nmechanism = Mechanism(2, 0, rods=(Rod(None, 0), Rod(0, 1)))"


def run(video: Path, mechanism: Path) -> int:
    """The exit code of `keycld track`."""
    return main(["track", str(video), "--mechanism", str(mechanism), "--out", str(video.parent / "o")])


@pytest.mark.long
def test_places_and_angles_of_a_pendulum_whose_pivot_is_out_of_view(tmp_path):
    times = np.arange(120) / 30
    angles, pivot, length = swing(times), np.array([320.0, -60.0]), 330.0
    bobs = draw_pendulum(tmp_path / "a.mp4", angles, (640, 360), pivot, length, hidden=slice(60, 66))
    found = track(read(tmp_path / "a.mp4", PENDULUM), PENDULUM, 0, nothing)
    error = found.keypoints[:, 0] - bobs
    assert not found.found[60:66].any()
    assert found.found[:60].mean() > 0.98 and found.found[66:].mean() > 0.98
    assert np.abs(np.nanmean(error, axis=0)).max() < 0.3
    assert np.nanstd(error, axis=0).max() < 0.25
    assert abs(found.lengths[0] / length - 1) < 0.02
    assert np.nanstd(found.angles[:, 0] - angles) < 0.005
    assert abs(np.nanmean(found.angles[:, 0] - angles)) < 0.01


@pytest.mark.long
def test_angles_and_lengths_of_a_double_pendulum(tmp_path):
    ends, angles = draw_chain(tmp_path / "a.mp4", 2.0, (1280, 720), hidden=slice(40, 45))
    marks = np.rint(ends[10] + [[2, -1], [-1, 1], [1, 2]])
    found = track(read(tmp_path / "a.mp4", TWO_LINKS), TWO_LINKS, 0, nothing, marks, 10)
    seen = np.r_[:40, 45:60]
    assert not found.found[40:45, 1].any() and found.found[seen].mean() > 0.9 and found.found[:, 0].mean() > 0.9
    assert np.abs(np.nanmean(found.keypoints - ends[:, 1:], axis=0)).max() < 2
    lengths = np.linalg.norm(np.diff(ends[0], axis=0), axis=1)
    assert np.abs(found.lengths / lengths - 1).max() < 0.025
    error = np.sqrt(np.nanmean((found.angles - angles) ** 2, axis=0))
    assert error.max() < 0.01
    claimed = error / np.nanmedian(found.deviation, axis=0)
    assert ((claimed > 0.2) & (claimed < 4)).all()
    assert found.trusted[seen].mean() > 0.85


@pytest.mark.long
def test_a_link_that_leaves_the_plane_is_not_trusted(tmp_path):
    ends, _ = draw_chain(tmp_path / "a.mp4", 2.5, (640, 360), leaning=slice(45, 60))
    found = track(read(tmp_path / "a.mp4", TWO_LINKS), TWO_LINKS, 0, nothing, ends[0], 0)
    assert found.trusted[45:60, 1].mean() < 0.2
    assert found.trusted[:45].mean() > 0.9 and found.trusted[:, 0].mean() > 0.9


@pytest.mark.slow
def test_command_writes_a_recording_a_clip_and_a_page(tmp_path, capsys):
    times = np.arange(150) / 25
    draw_pendulum(tmp_path / "a.mp4", swing(times), (256, 144), np.array([128.0, 10.0]), 95.0, fps=25.0)
    (tmp_path / "m.py").write_text(
        "from keycld_envs import Mechanism, Rod\nmechanism = Mechanism(1, 0, rods=(Rod(None, 0),))\n"
    )
    words = ["track", str(tmp_path / "a.mp4"), "--mechanism", str(tmp_path / "m.py"), "--out", str(tmp_path / "out")]
    assert main([*words, "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert abs(numbers["period_s"] / 1.2 - 1) < 0.01
    assert abs(numbers["length_px"][0] / 95 - 1) < 0.02
    recording = read_recording(tmp_path / "out")
    assert recording.keypoints is not None and recording.keypoints.shape == (150, 1, 2)
    assert recording.qpos_std is not None and np.nanmedian(recording.qpos_std) < 0.02
    for name in ("overlay.mp4", "report.html", "track.json"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    assert '<video controls loop muted playsinline src="overlay.mp4"' in (tmp_path / "out" / "report.html").read_text()
    assert main(words) == 2


@pytest.mark.parametrize("content", [b"", b"no video at all"])
def test_what_is_no_video_is_refused_with_one_sentence(tmp_path, capsys, content):
    (tmp_path / "a.mp4").write_bytes(content)
    code = main(
        ["track", str(tmp_path / "a.mp4"), "--mechanism", "examples/apple_pendulum.py", "--out", str(tmp_path / "o")]
    )
    message = capsys.readouterr().err.strip()
    assert code == 2 and len(message.splitlines()) == 1 and "a.mp4" in message
    assert not (tmp_path / "o").exists()


def test_a_negative_seed_is_refused(tmp_path, capsys):
    words = ["track", str(tmp_path / "a.mp4"), "--mechanism", "examples/apple_pendulum.py", "--seed", "-1"]
    assert main([*words, "--out", str(tmp_path / "o")]) == 2
    assert "seed is -1" in capsys.readouterr().err


def test_a_truncated_video_is_refused(tmp_path, capsys):
    draw_pendulum(tmp_path / "a.mp4", swing(np.arange(40) / 30), (96, 64), np.array([48.0, 0.0]), 45.0)
    whole = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    code = main(
        ["track", str(tmp_path / "cut.mp4"), "--mechanism", "examples/apple_pendulum.py", "--out", str(tmp_path / "o")]
    )
    assert code == 2 and "cut.mp4" in capsys.readouterr().err


def test_what_slides_turns_about_no_pivot(tmp_path, capsys):
    rng, times = np.random.default_rng(0), np.arange(90) / 30
    wall = 150 + 20 * gaussian_filter(rng.normal(size=(90, 160, 1)), (2, 2, 0)) / 0.14
    rows, columns = np.mgrid[:90, :160]
    frames = []
    for x in 80 + 45 * np.cos(4 * times):
        disc = np.clip(9.5 - np.hypot(rows - 45, columns - x), 0, 1)[..., None]
        frames.append(np.clip(wall * (1 - disc) + disc * [190, 40, 40] + rng.normal(0, 2, wall.shape), 0, 255))
    write_video(tmp_path / "cart.mp4", [frame.astype(np.uint8) for frame in frames], (160, 90), 30.0, **CAMERA)
    assert run(tmp_path / "cart.mp4", EXAMPLE) == 2
    assert "cart.mp4 goes straight" in capsys.readouterr().err


def test_a_still_video_is_refused(tmp_path, capsys):
    draw_pendulum(tmp_path / "a.mp4", np.zeros(30), (96, 64), np.array([48.0, 0.0]), 40.0)
    code = main(
        ["track", str(tmp_path / "a.mp4"), "--mechanism", "examples/apple_pendulum.py", "--out", str(tmp_path / "o")]
    )
    assert code == 2 and "a.mp4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("x = 1", "mechanism"),
        ("mechanism = 3", "int"),
        ("import nothing_of_the_kind", "ModuleNotFoundError"),
        (
            "from keycld_envs import Mechanism, Rod\nmechanism = Mechanism(2, 0, rods=(Rod(None, 0), Rod(None, 1)))",
            "keypoint",
        ),
    ],
)
def test_mechanism_files_that_cannot_be_used(tmp_path, capsys, text, names):
    (tmp_path / "m.py").write_text(text)
    (tmp_path / "a.mp4").write_bytes(b"")
    code = run(tmp_path / "a.mp4", tmp_path / "m.py")
    message = capsys.readouterr().err
    assert code == 2 and names in message and len(message.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ([], "3 pairs"),
        (["--marks", "10", "10", "20", "20"], "it needs 3"),
        (["--marks", "10", "10", "20", "20", "20", "22"], "apart"),
        (["--marks", "10", "10", "20", "20", "500", "22"], "outside"),
        (["--marks", "10", "10", "20", "20", "30", "22", "--frame", "99"], "--frame"),
    ],
)
def test_marks_that_cannot_be_used(tmp_path, capsys, words, names):
    draw_pendulum(tmp_path / "a.mp4", swing(np.arange(20) / 30), (96, 64), np.array([48.0, 0.0]), 45.0)
    (tmp_path / "m.py").write_text(DOUBLE)
    code = main(
        ["track", str(tmp_path / "a.mp4"), "--mechanism", str(tmp_path / "m.py"), "--out", str(tmp_path / "o"), *words]
    )
    message = capsys.readouterr().err
    assert code == 2 and names in message and len(message.strip().splitlines()) == 1


@pytest.mark.long
def test_a_video_that_lies_on_its_side_is_remarked_on(tmp_path):
    times = np.arange(200) / 30
    draw_pendulum(tmp_path / "a.mp4", swing(times), (640, 360), np.array([320.0, -60.0]), 330.0)
    turned = [np.rot90(frame).copy() for frame in decode(tmp_path / "a.mp4")]
    write_video(tmp_path / "b.mp4", turned, (360, 640), 30.0, **CAMERA)
    for name, sideways in (("a.mp4", False), ("b.mp4", True)):
        found = track(read(tmp_path / name, PENDULUM), PENDULUM, 0, nothing)
        study = study_pendulum(found.film.times, found.angles[:, 0], 0, nothing)
        assert study is not None and abs(study.period[0] / 1.2 - 1) < 0.01
        assert any("the video is turned" in doubt for doubt in doubts(found, study)) == sideways
