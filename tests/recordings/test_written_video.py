"""A video counts when it has been read back."""

import subprocess
import sys

import imageio_ffmpeg
import numpy as np
import pytest

from keycld_envs.errors import InputError
from keycld_envs.recordings import video
from keycld_envs.recordings.video import iter_video, write_video

FRAMES = np.random.default_rng(0).integers(0, 256, (12, 32, 32, 3)).astype(np.uint8)
FULL_DISK = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))  # no file may be longer, as if the disk were full
import numpy as np
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
frames = np.random.default_rng(0).integers(0, 256, (12, 32, 32, 3)).astype(np.uint8)
try:
    write_recording(sys.argv[1], Recording(id="a", source="real", t_frame=np.arange(12.0), frames=frames), video=True)
except InputError as error:
    print(error)
    sys.exit(2)
"""


def test_what_is_written_is_read_back(tmp_path):
    write_video(tmp_path / "a.mkv", FRAMES, (32, 32), 25)
    np.testing.assert_array_equal(list(iter_video(tmp_path / "a.mkv", 12)), FRAMES)


def test_a_video_that_lacks_frames_is_none(tmp_path, monkeypatch):
    whole = video.decode

    def one_less(path):
        yield from list(whole(path))[:-1]

    monkeypatch.setattr(video, "decode", one_less)
    with pytest.raises(InputError, match=r"a\.mkv could not be written whole"):
        write_video(tmp_path / "a.mkv", FRAMES, (32, 32), 25)


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files")
def test_a_full_disk_leaves_no_recording(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path / "a")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "a/frames.mkv could not be written whole; free space" in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore:os.fork")  # ffmpeg is run at once
def test_pixels_that_are_not_square_are_made_so(tmp_path):
    """Stored half as wide as it is shown."""
    path, frame = tmp_path / "wide.mp4", np.zeros((96, 64, 3), np.uint8)
    frame[:, 16:32] = 255
    writer = imageio_ffmpeg.write_frames(str(path), (64, 96), fps=25, output_params=["-vf", "setsar=2/1"])
    writer.send(None)
    for _ in range(5):
        writer.send(frame)
    writer.close()
    shown = next(video.decode(path))
    assert shown.shape == (96, 128, 3)
    assert shown[40, 40:56].min() > 200 and shown[40, 70:].max() < 50
    part = next(video.decode(path, crop=(32, 0, 32, 96)))
    assert part.shape == (96, 32, 3) and part.min() > 180
