"""A video in memory: one channel of it, at a working size, with the time of each frame."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.reading import read_limit
from keycld_envs.recordings.survey import survey
from keycld_envs.recordings.video import decode

Array = NDArray[np.float64]
LONGEST_SIDE = 960
"""Pixels of the working size, unless memory asks for fewer."""
SAMPLES = 32
"""Frames in which the colour is sought that tells moving things from the background."""
SHORTEST = 12
"""Frames below which nothing can be said about a motion."""


@dataclass(frozen=True, eq=False)
class Film:
    """A video as tracking uses it.

    Attributes:
        path: of the file.
        times: [T], seconds.
        pixels: [T, h, w] uint8, the brightness along the colour in which moving things differ most.
        size: (W, H) of the video as it is shown, pixels.
        clock: "time stamps" of the file, or "frame rate" where it has none of use.
        repeated: [T] bool, the frame is a copy of the one before it.
    """

    path: Path
    times: Array
    pixels: NDArray[np.uint8]
    size: tuple[int, int]
    clock: str
    repeated: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def scale(self) -> float:
        """Pixels of the video in one working pixel."""
        return self.size[0] / self.pixels.shape[2]

    def to_video(self, points: Array) -> Array:
        """Working pixels [..., 2] as pixels of the video; centres of the first pixels are 0."""
        return (points + 0.5) * self.scale - 0.5


def read_film(path: Path, fps: float | None = None) -> Film:
    """Read a video.

    Args:
        path: a file ffmpeg can read.
        fps: frame rate, Hz, in place of the file's time stamps.

    Raises:
        InputError: if it is missing, damaged, cut short, or too short, or does not say when its frames were taken.
    """
    found = survey(path, _thinned, SAMPLES, SHORTEST, fps)
    times, size, count = found.times, found.size, len(found.times)
    colour = _moving_colour(found.samples)
    smaller = _working_size(size, count)
    pixels = np.empty((count, smaller[1], smaller[0]), np.uint8)
    repeated = np.zeros(count, bool)
    last: NDArray[np.uint8] | None = None
    for i, frame in enumerate(decode(path, None if smaller == size else smaller)):
        low = 255 * np.minimum(colour, 0).sum()
        pixels[i] = np.rint((frame.astype(np.float32) @ colour - low) / np.abs(colour).sum())
        repeated[i] = last is not None and np.array_equal(frame, last)
        last = frame
    return Film(path, times, pixels, size, "time stamps" if fps is None else "frame rate", repeated)


def _thinned(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Some of a frame's pixels, at most 240 in a row or column."""
    step = max(1, math.ceil(max(frame.shape[:2]) / 240))
    return frame[::step, ::step].copy()


def _moving_colour(samples: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The unit vector of RGB along which pixels differ most from the median of all frames."""
    away = samples.astype(np.float32) - np.median(samples, axis=0).astype(np.float32)
    away = away.reshape(-1, 3)
    strength = np.linalg.norm(away, axis=1)
    strong = away[strength > max(np.quantile(strength, 0.98), 1.0)]
    if len(strong) < 10:
        return np.full(3, 3**-0.5, np.float32)
    direction = np.linalg.eigh(strong.T @ strong)[1][:, -1]
    return (direction * (np.sign(direction.sum()) or 1)).astype(np.float32)


def _working_size(size: tuple[int, int], count: int) -> tuple[int, int]:
    """The largest size of the same shape within `LONGEST_SIDE` and the limit of memory."""
    share = min(1.0, LONGEST_SIDE / max(size), math.sqrt(0.7 * read_limit() / (count * size[0] * size[1])))
    return size if share == 1 else (max(2, round(size[0] * share)), max(2, round(size[1] * share)))
