"""Frames cut to where something moves, and made as small as models are trained on."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from keycld_envs.checks import check_size
from keycld_envs.errors import InputError
from keycld_envs.recordings.recording import Recording

MARGIN = 1.1
"""Side of the square in which something moves, by which it is widened."""
LEVELS = 8.0
"""Of 255, the standard deviation of a pixel in which something moves."""
Box = tuple[int, int, int, int]
"""Left, top, right and bottom, pixels; right and bottom are exclusive."""


def moving_box(frames: Iterable[NDArray[np.uint8]]) -> Box | None:
    """The box of what changes in frames [H, W, 3] of one fixed camera; None if nothing does."""
    count, total, squares = 0, np.zeros(()), np.zeros(())
    for frame in frames:
        pixels = frame.astype(np.float64)
        count, total, squares = count + 1, total + pixels, squares + pixels**2
    if not count:
        return None
    changes = np.sqrt(np.maximum(squares / count - (total / count) ** 2, 0)).max(axis=-1)
    rows, columns = np.nonzero(changes > max(LEVELS, 0.1 * changes.max()))
    if not len(rows):
        return None
    return int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1


def reduced(frame: NDArray[np.uint8], longest: int) -> NDArray[np.uint8]:
    """A frame [H, W, 3] of at most `longest` pixels, by means over squares; what is left at the borders is cut."""
    every = -(-max(frame.shape[:2]) // longest)
    if every == 1:
        return frame
    height, width = (side // every for side in frame.shape[:2])
    top, left = (frame.shape[0] - height * every) // 2, (frame.shape[1] - width * every) // 2
    cut = frame[top : top + height * every, left : left + width * every].astype(np.float32)
    return cut.reshape(height, every, width, every, 3).mean(axis=(1, 3)).round().astype(np.uint8)


def square(box: Box, width: int, height: int) -> Box:
    """The square around a box with a margin, as far as it fits into an image of `width` by `height` pixels."""
    side = min(width, height, round(MARGIN * max(box[2] - box[0], box[3] - box[1])))
    left = min(max(0, round((box[0] + box[2] - side) / 2)), width - side)
    top = min(max(0, round((box[1] + box[3] - side) / 2)), height - side)
    return left, top, left + side, top + side


def units_of(box: Box, width: int, height: int, size: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Factors of x and y, and shifts, from image units of frames of `width` by `height` pixels to those of a box."""
    factors, shifts = [], []
    for first, last, pixels, sign in ((box[0], box[2], width, 1), (box[1], box[3], height, -1)):
        scale = size / (last - first)
        factors.append(scale * (pixels - 1) / (size - 1))
        middle = (pixels / 2 - first) * scale - 0.5  # where the old middle, (pixels - 1) / 2, has come to
        shifts.append(sign * (2 * middle / (size - 1) - 1))
    return (factors[0], factors[1]), (shifts[0], shifts[1])


def cropped(recording: Recording, box: Box, size: int) -> Recording:
    """The recording with frames of `size` by `size` pixels, of what a box of the old ones shows.

    Tracked keypoints and pivots go along. What the camera said of the world no longer holds and is left out.

    Raises:
        InputError: if the box is no square within the frames, or there are none.
    """
    check_size("size", size)
    frames = []
    for frame in recording.iter_frames():
        height, width = frame.shape[:2]
        if not (0 <= box[0] < box[2] <= width and 0 <= box[1] < box[3] <= height) or box[2] - box[0] != box[3] - box[1]:
            raise InputError(f"The box {box} is no square within frames of {width}x{height} pixels; correct it.")
        frames.append(np.asarray(Image.fromarray(frame).resize((size, size), Image.Resampling.BOX, box)))
    if not frames:
        raise InputError(f"Recording {recording.id!r} has no frames to cut; name recordings of a camera.")
    scale, corner = size / (box[2] - box[0]), np.array(box[:2])

    def moved(points: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
        return None if points is None else (points + 0.5 - corner) * scale - 0.5  # whole numbers are pixels' centres

    covariance = recording.keypoint_covariance
    return replace(
        recording,
        frames=np.stack(frames),
        video=None,
        camera={"width": size, "height": size},
        keypoints=moved(recording.keypoints),
        keypoint_covariance=None if covariance is None else covariance * scale**2,
        pivot=moved(recording.pivot),
        notes=f"{recording.notes}; frames cut to columns {box[0]} to {box[2]}, rows {box[1]} to {box[3]}".lstrip("; "),
    )
