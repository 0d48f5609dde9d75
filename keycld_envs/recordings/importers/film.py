"""A data set from a video: a square part of it, reduced, and cut into recordings of steady frame rate."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_folder
from keycld_envs.progress import Advance
from keycld_envs.recordings.crop import moving_box
from keycld_envs.recordings.recording import Recording
from keycld_envs.recordings.storage import write_recording
from keycld_envs.recordings.survey import survey
from keycld_envs.recordings.video import decode

SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg")
LOOK = 320
"""Width at which motion is looked for, pixels."""
SAMPLES = 64
"""Frames in which it is looked for, at least, evenly spread; twice as many at most."""
LARGEST = 8192
"""Pixels of the side of a square that is kept, and of the frames that are written."""
FARTHEST = 16
"""Times the size of what moves that a square around a pivot may have, before little is left of the motion in it."""
MARGIN = 0.12
"""Of the moving region's longer side, left free around it."""
STEADY = 0.05
"""Share by which intervals between frames may differ, as in training."""


def is_video(path: Path) -> bool:
    """Whether a file is one, by its name."""
    return path.suffix.lower() in SUFFIXES


@dataclass(frozen=True)
class Look:
    """What a first look at a video tells.

    Attributes:
        size: (W, H) as it is shown, pixels.
        times: [T], seconds.
        moving: (left, top, right, bottom) of the region in which anything moves, pixels; None if nothing does.
    """

    size: tuple[int, int]
    times: NDArray[np.float64]
    moving: tuple[float, float, float, float] | None


@dataclass(frozen=True)
class Square:
    """A square part of a picture, which may reach beyond its border.

    Attributes:
        left: column of its first pixel.
        top: row of its first pixel.
        side: pixels.
    """

    left: int
    top: int
    side: int

    def units(self, column: float, row: float) -> tuple[float, float]:
        """A pixel of the video in image units of the square: -1 and 1 at the centres of its outermost pixels, y up."""
        middle = (self.side - 1) / 2
        return (column - self.left) / middle - 1, 1 - (row - self.top) / middle

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """The inverse of `units`."""
        middle = (self.side - 1) / 2
        return self.left + (x + 1) * middle, self.top + (1 - y) * middle

    def within(self, size: tuple[int, int]) -> tuple[int, int, int, int]:
        """(left, top, right, bottom) of what a picture of this (W, H) shows of the square, pixels; may be empty."""
        right, bottom = min(self.left + self.side, size[0]), min(self.top + self.side, size[1])
        return max(self.left, 0), max(self.top, 0), right, bottom

    def share_within(self, size: tuple[int, int]) -> float:
        """How much of the square a picture of this (W, H), pixels, covers, 0 to 1."""
        left, top, right, bottom = self.within(size)
        return max(0, right - left) * max(0, bottom - top) / self.side**2 if self.side > 0 else 0.0


def look_at(path: Path, fps: float | None = None) -> Look:
    """Decode a video once.

    Args:
        path: a file ffmpeg can read.
        fps: frames per second, in place of the file's time stamps.

    Raises:
        InputError: if it is missing, damaged, cut short or too short, or does not say when its frames were taken.
    """
    found = survey(path, _small, SAMPLES, fps=fps)
    box, scale = moving_box(found.samples), found.size[0] / found.samples.shape[2]
    return Look(found.size, found.times, None if box is None else tuple(scale * edge for edge in box))


def square_around(
    look: Look, place: tuple[float, float] = (0.0, 0.0), pivot: tuple[float, float] | None = None
) -> Square:
    """The smallest square that holds all that moves.

    Args:
        look: at the video.
        place: where the pivot shall be in the square, image units.
        pivot: (column, row) of the fixed pivot in the video, pixels; without, what moves is in the middle.

    Raises:
        InputError: if nothing moves, or the pivot is where no square can have it there.
    """
    if look.moving is None:
        raise InputError("Nothing moves in the video; name the part to keep with --crop LEFT TOP SIDE.")
    left, top, right, bottom = look.moving
    free = MARGIN * max(right - left, bottom - top)
    left, top, right, bottom = left - free, top - free, right + free, bottom + free
    if pivot is None:
        side = math.ceil(max(right - left, bottom - top))
        return Square(round((left + right - side) / 2), round((top + bottom - side) / 2), side)
    x, y = (place[0] + 1) / 2, (1 - place[1]) / 2  # shares of the side to the left of the pivot, and above it
    if not (0 < x < 1 and 0 < y < 1):
        raise InputError(f"The mechanism has its pivot at {place}, outside its picture; name --crop LEFT TOP SIDE.")
    if not np.isfinite(pivot).all():
        raise InputError(f"--pivot is {pivot[0]:g} {pivot[1]:g}; it must be a column and a row, pixels.")
    needed = ((pivot[0] - left) / x, (right - pivot[0]) / (1 - x), (pivot[1] - top) / y, (bottom - pivot[1]) / (1 - y))
    side = math.ceil(max(needed))
    if side > FARTHEST * max(right - left, bottom - top):
        raise InputError(
            f"--pivot {pivot[0]:g} {pivot[1]:g} is far from all that moves, columns {left:.0f} to {right:.0f} and rows "
            f"{top:.0f} to {bottom:.0f}; name its place in pixels of the video as it is shown, or what to keep with "
            "--crop LEFT TOP SIDE."
        )
    return Square(round(pivot[0] - x * (side - 1)), round(pivot[1] - y * (side - 1)), side)


@dataclass(frozen=True)
class Cut:
    """How a video becomes recordings.

    Attributes:
        size: width and height of the frames to write, pixels.
        frames: of each recording.
        every: keep one in so many frames.
        licence: of the video.
        origin: where it comes from; by default the file's name.
    """

    size: int = 64
    frames: int = 50
    every: int = 1
    licence: str = ""
    origin: str = ""

    def __post_init__(self) -> None:
        for name, least in (("size", 8), ("frames", 5), ("every", 1)):
            if (value := getattr(self, name)) < least:
                raise InputError(f"--{name} is {value}; it must be {least} at least.")
        if self.size > LARGEST:
            raise InputError(f"--size is {self.size}; it must be {LARGEST} pixels at most.")


def write_parts(path: Path, out: Path, look: Look, square: Square, advance: Advance, cut: Cut = Cut()) -> int:
    """Write recordings `NAME-0000`, `NAME-0001`, ... of consecutive frames, without actions, as a data set.

    Where the camera left out frames, a recording ends; what is left of less than `cut.frames` is not used.

    Args:
        path: the video.
        out: folder to create, complete or not at all.
        look: at it.
        square: the part that is kept; beyond the border, the border's pixels are repeated.
        advance: called for every frame.
        cut: sizes, and where the video comes from.

    Returns:
        How many recordings were written.

    Raises:
        InputError: if the folder exists, the square shows nothing of the video, or nothing is long enough.
    """
    width, height = look.size
    if square.share_within(look.size) == 0:
        named = f"{square.left} {square.top} {square.side}"
        raise InputError(f"--crop {named} shows nothing of {path}, which is {width}×{height} pixels; name another.")
    if square.side > LARGEST:
        raise InputError(
            f"The square to keep of {path} is {square.side} pixels wide; --crop must be {LARGEST} at most."
        )
    times = look.times[:: cut.every]
    starts = _steady(times, cut.frames)
    if not starts:
        most = max(n for n in range(1, min(cut.frames, len(times)) + 1) if _steady(times, n))
        raise InputError(
            f"{path} has no {cut.frames} frames in a row of steady rate (one in {cut.every} of {len(look.times)} is "
            f"kept, {most} in a row at most); film for longer and at a fixed rate, or choose fewer --frames."
        )
    last = {start + cut.frames - 1: number for number, start in enumerate(starts)}
    buffer: deque[NDArray[np.uint8]] = deque(maxlen=cut.frames)
    try:
        with atomic_folder(out) as partial:
            for i, frame in enumerate(_reduced(path, look.size, square, cut.size)):
                advance()
                k, left_out = divmod(i, cut.every)
                if left_out:
                    continue
                buffer.append(frame)
                if k in last:
                    part = _part(path, last[k], times[k + 1 - cut.frames : k + 1], np.stack(buffer), square, look, cut)
                    write_recording(partial / part.id, part)
    except FileExistsError as error:
        raise InputError(f"{out} exists already; choose another folder or remove it.") from error
    return len(starts)


def _part(
    path: Path,
    number: int,
    times: NDArray[np.float64],
    frames: NDArray[np.uint8],
    square: Square,
    look: Look,
    cut: Cut,
) -> Recording:
    seen = {"crop": [square.left, square.top, square.side], "video": list(look.size)}
    return Recording(
        id=f"{path.stem}-{number:04d}",
        source="real",
        camera={"width": cut.size, "height": cut.size, **seen},
        licence=cut.licence,
        origin=cut.origin or path.name,
        notes=f"{times[0]:.3f} s to {times[-1]:.3f} s of the video",
        t_frame=times - times[0],
        frames=frames,
    )


def _steady(times: NDArray[np.float64], frames: int) -> list[int]:
    """Where runs of so many frames of steady rate start, one after the other."""
    steps = np.diff(times)
    off = np.abs(steps - np.median(steps)) > STEADY * np.median(steps)
    starts, k = [], 0
    while k + frames <= len(times):
        gaps = np.flatnonzero(off[k : k + frames - 1])
        if len(gaps):
            k += int(gaps[-1]) + 1
        else:
            starts.append(k)
            k += frames
    return starts


def _reduced(path: Path, size: tuple[int, int], square: Square, pixels: int) -> Iterator[NDArray[np.uint8]]:
    """The square of every frame, [pixels, pixels, 3]."""
    left, top, right, bottom = square.within(size)
    beyond = (
        (top - square.top, square.top + square.side - bottom),
        (left - square.left, square.left + square.side - right),
    )
    for frame in decode(path, crop=(left, top, right - left, bottom - top)):
        whole = np.pad(frame, (*beyond, (0, 0)), mode="edge") if any(map(any, beyond)) else frame
        yield np.asarray(Image.fromarray(whole).resize((pixels, pixels), Image.Resampling.BOX))


def _small(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A frame in the size in which motion is looked for."""
    height, width = frame.shape[:2]
    share = min(1.0, LOOK / width)
    size = max(1, round(width * share)), max(1, round(height * share))
    return np.asarray(Image.fromarray(frame).resize(size, Image.Resampling.BOX))
