"""A first look at a video: its size, when its frames were taken, and some of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings.video import Frame, decode, frame_times


@dataclass(frozen=True, eq=False)
class Survey:
    """What a video is.

    Attributes:
        size: (W, H) as it is shown, pixels.
        times: [T], seconds.
        samples: [S, h, w, 3] uint8, some of its frames, evenly spread and reduced.
    """

    size: tuple[int, int]
    times: NDArray[np.float64]
    samples: NDArray[np.uint8]


def survey(
    path: Path, reduced: Callable[[Frame], Frame], samples: int, shortest: int = 2, fps: float | None = None
) -> Survey:
    """Decode a video once.

    Args:
        path: a file ffmpeg can read.
        reduced: makes a frame smaller, before it is kept.
        samples: frames to keep, at least, if there are as many; twice as many at most.
        shortest: frames below which it is refused.
        fps: frames per second, in place of the file's time stamps.

    Raises:
        InputError: if it is missing, damaged, cut short or too short, or does not say when its frames were taken.
    """
    kept: list[Frame] = []
    count, every, size, stamps = 0, 1, (0, 0), np.empty(0)
    try:
        if path.is_file() and not path.stat().st_size:
            raise ValueError("it is empty")
        for frame in decode(path):
            size = frame.shape[1], frame.shape[0]
            if count % every == 0:
                kept.append(reduced(frame))
                if len(kept) == 2 * samples:
                    kept, every = kept[::2], 2 * every
            count += 1
        if not kept:
            raise ValueError("it holds no frame")
        stamps = frame_times(path) if fps is None else stamps
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a video file.") from error
    except (OSError, ValueError) as error:
        why = str(error).strip().rstrip(".")[:200] or type(error).__name__
        raise InputError(f"{path} cannot be decoded as a video ({why}); copy or export it again.") from error
    if count < shortest:
        raise InputError(f"{path} holds {count} frames; a motion needs at least {shortest}, so film for longer.")
    return Survey(size, _times(path, count, stamps, fps), np.stack(kept))


def _times(path: Path, count: int, stamps: NDArray[np.float64], fps: float | None) -> NDArray[np.float64]:
    if fps is not None:
        if not 0 < fps < math.inf:
            raise InputError(f"--fps is {fps}; it must be a positive number of frames per second.")
        return np.arange(count) / fps
    if len(stamps) != count:
        raise InputError(
            f"{path} has no rising time stamp for each of its {count} frames; say how fast it was filmed with --fps."
        )
    return stamps
