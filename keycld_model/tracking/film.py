"""A video in memory: one channel of it, at a working size, with the time of each frame."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.reading import read_limit
from keycld_envs.recordings.video import decode, frame_times

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
    try:
        count, size, samples = _sample(path)
        times = frame_times(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a video file.") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be decoded as a video ({_short(error)}); copy or export it again.") from error
    if count < SHORTEST:
        raise InputError(f"{path} holds {count} frames; a motion needs at least {SHORTEST}, so film for longer.")
    if fps is not None:
        if not 0 < fps < math.inf:
            raise InputError(f"--fps is {fps}; it must be a positive number of frames per second.")
        times = np.arange(count) / fps
    if len(times) != count:
        raise InputError(
            f"{path} has no rising time stamp for each of its {count} frames; say how fast it was filmed with --fps."
        )
    colour = _moving_colour(samples)
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


def _sample(path: Path) -> tuple[int, tuple[int, int], NDArray[np.uint8]]:
    """Number of frames, their size, and some of them, evenly spread, at most 240 pixels wide."""
    kept: list[NDArray[np.uint8]] = []
    count, every, size = 0, 1, (0, 0)
    for frame in decode(path):
        size = frame.shape[1], frame.shape[0]
        if count % every == 0:
            step = max(1, math.ceil(max(size) / 240))
            kept.append(frame[::step, ::step].copy())
            if len(kept) == 2 * SAMPLES:
                kept, every = kept[::2], 2 * every
        count += 1
    if not kept:
        raise ValueError("it holds no frame")
    return count, size, np.stack(kept)


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


def _short(error: Exception) -> str:
    text = str(error).strip().rstrip(".")
    return text[:200] if text else type(error).__name__
