import imageio.v3 as iio
import numpy as np
import pytest
from PIL import Image

from keycld_control.video import PANEL, STRIP, Moment, check_clip_path, draw_clip, write_clip
from keycld_envs import InputError, get_system

TARGET, PIVOT = np.array([[0.0, 0.4], [0.0, 0.7]], np.float32), np.zeros(2, np.float32)


def moments(count: int) -> list[Moment]:
    image = np.zeros((64, 64, 3), np.uint8)
    corner = np.array([[-1.0, 1.0], [0.5, 0.0]], np.float32)  # the centre of the top left pixel
    return [Moment(0.1 * i, image, corner, float(i)) for i in range(count)]


def clip(count: int) -> list[np.ndarray]:
    return list(draw_clip(moments(count), get_system("acrobot").mechanism, TARGET, PIVOT, 2.0))


def test_keypoints_are_drawn_where_they_are():
    picture = clip(3)[0]
    assert picture.shape == (PANEL + STRIP, PANEL, 3)
    pixel = PANEL / 64
    yellow = np.array([255, 210, 63])
    assert np.abs(picture[round(pixel / 2), round(pixel / 2)] - yellow).max() < 30
    assert np.abs(picture[round(PANEL / 2), round((0.75 * 63 + 0.5) * pixel)] - yellow).max() < 30
    assert picture[round(PANEL * 0.9), round(PANEL * 0.9)].max() == 0


def test_the_energy_curve_grows():
    def drawn(picture: np.ndarray) -> int:
        strip = picture[PANEL + 20 :].astype(int)
        return int(((strip[..., 0] > 200) & (strip[..., 2] < 120)).sum())

    pictures = clip(5)
    assert drawn(pictures[0]) < drawn(pictures[2]) < drawn(pictures[4])


@pytest.mark.filterwarnings("ignore:os.fork")  # imageio starts ffmpeg to read
@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_clips_hold_every_picture(tmp_path, suffix):
    path = tmp_path / f"clip{suffix}"
    pictures = clip(5)
    write_clip(path, iter(pictures), 10)
    found = iio.imread(path, **({"plugin": "pillow", "index": None} if suffix == ".gif" else {}))
    assert found.shape == (5, PANEL + STRIP, PANEL, 3)
    assert np.abs(found[-1].astype(int) - pictures[-1]).mean() < 8
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    if suffix == ".gif":
        assert Image.open(path).info["duration"] == 100


def test_other_formats_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.mp4 or \.gif"):
        check_clip_path(tmp_path / "clip.avi")
