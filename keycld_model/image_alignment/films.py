"""Frames of recordings, in memory, of one size."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_envs.recordings.crop import reduced
from keycld_model.image_alignment.chroma import HalvedChroma

Array = NDArray[np.float64]
Frames = NDArray[np.uint8]
LARGEST = 96
"""Pixels along the longer side of images that are aligned; larger frames are reduced by a whole number."""
LEAP = 0.5
"""Times the usual change of the picture from frame to frame, beside frames that are repeated; what rests slows down."""


@dataclass(frozen=True)
class Films:
    """Frames of recordings.

    Attributes:
        times: of each recording, `[T]` s.
        frames: of each, `[T, H, W, 3]`.
        repeated: number of frames that are left out of all, because they show an earlier one again.
        halved: what drawings become that are compared with frames of luma and chroma; None if frames are of red, green
            and blue.
    """

    times: tuple[Array, ...]
    frames: tuple[Frames, ...]
    repeated: int = 0
    halved: HalvedChroma | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return self.frames[0].shape[1], self.frames[0].shape[2]

    @property
    def number(self) -> int:
        """Of all frames."""
        return sum(len(frames) for frames in self.frames)

    def spread(self, number: int) -> list[tuple[int, NDArray[np.float32]]]:
        """About so many frames, spread over all recordings and their time, each with the index of its recording."""
        each = max(2, round(number / len(self.frames)))
        return [
            (r, frames[k].astype(np.float32))
            for r, frames in enumerate(self.frames)
            for k in np.unique(np.linspace(0, len(frames) - 1, each).round().astype(int))
        ]


def read_films(recordings: Sequence[Recording]) -> Films:
    """The frames of recordings without repeated ones; large ones are reduced, and those with halved chroma separated.

    Raises:
        InputError: if there are none, or of several sizes, or fewer than two in a recording.
    """
    times, films, repeated = [], [], 0
    for recording in recordings:
        times.append(frame_times(recording))
        films.append(np.stack([reduced(frame, LARGEST) for frame in recording.iter_frames()]))
        if films[-1].shape[1:] != films[0].shape[1:]:
            sizes = ["×".join(map(str, film.shape[2:0:-1])) for film in (films[0], films[-1])]
            raise InputError(
                f"Recording {recording.id!r} has frames of {sizes[1]} pixels, but {recordings[0].id!r} of {sizes[0]}; "
                "one camera with one setting is needed."
            )
        again = repeats(films[-1])
        times[-1], films[-1], repeated = times[-1][~again], films[-1][~again], repeated + int(again.sum())
    halved = HalvedChroma.of(films)
    seen = films if halved is None else [halved.filmed(frames) for frames in films]
    return Films(tuple(times), tuple(seen), repeated, halved)


def repeats(frames: Frames) -> NDArray[np.bool_]:
    """`[T]` which frames show an earlier one again, because a camera or a decoder left some out.

    They equal the one before in every pixel, and the picture changes half as fast as usual, or faster, where that
    begins or ends. A mechanism that comes to rest without any noise repeats itself as well, but gets slower first.

    Args:
        frames: `[T, H, W, 3]`.
    """
    changes = np.array([np.abs(b.astype(np.int16) - a).mean() for a, b in pairwise(frames)])
    same, out = changes == 0, np.zeros(len(frames), bool)
    if same.all() or not same.any():
        return out
    usual, k = float(np.median(changes[~same])), 0
    while k < len(changes):
        end = k
        while end < len(changes) and same[end]:
            end += 1
        beside = [changes[i] for i in (k - 1, end) if 0 <= i < len(changes)]
        out[k + 1 : end + 1] = max(beside) > LEAP * usual
        k = end + 1
    return out


def frame_times(recording: Recording) -> Array:
    """`[T]` s.

    Raises:
        InputError: if a recording has fewer than two frames.
    """
    if recording.t_frame is None or recording.num_frames < 2:
        raise InputError(
            f"Recording {recording.id!r} has {recording.num_frames} frames; film it, or leave out --observe pixels."
        )
    return np.asarray(recording.t_frame, np.float64)
