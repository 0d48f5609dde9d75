"""Frames from which a structure is found: few of many, reduced, some to be fitted and some held out."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Dataset
from keycld_envs.recordings.crop import moving_box, reduced

Array = NDArray[np.floating[Any]]
LONGEST = 96
"""Pixels of the longer side, beyond which frames are reduced."""
FRAMES = 120
"""Frames that are looked at; a part's shape is the mean of those that are fitted."""
FEWEST = 20
"""Frames that are needed at least."""
HELD_OUT = 5
"""One group of frames in so many is held out."""
GROUPS = 10
"""Pieces that frames of fewer than `HELD_OUT` recordings are cut into, so that held-out ones are apart in time."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Some frames of a data set.

    Attributes:
        fitted: [N, h, w, 3], 0 to 1, of which parts are learned.
        held_out: [M, h, w, 3], 0 to 1, which no fit sees.
        background: [h, w, 3], the median over frames of all recordings.
        shape: (H, W) of the recordings' frames, pixels.
        reduction: pixels of the recordings per pixel here.
    """

    fitted: Array
    held_out: Array
    background: Array
    shape: tuple[int, int]
    reduction: int

    def to_image(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points [..., 2] from pixels here (x right, y down) to image units (-1 to 1, x right, y up)."""
        size = np.array(self.shape[::-1])
        pixels = (points + 0.5) * self.reduction - 0.5 + size % self.reduction // 2  # what was cut at the border
        half = (size - 1) / 2
        return (pixels / half - 1) * (1.0, -1.0)


def read_frames(dataset: Dataset) -> Frames:
    """Take frames evenly from all recordings.

    Args:
        dataset: recordings with frames of one size; the camera stands still.

    Raises:
        InputError: if there are no frames, too few, frames of several sizes, or nothing moves.
    """
    counts = [recording.num_frames for recording in dataset.recordings]
    total = sum(counts)
    if not total:
        raise InputError(f"The recordings of {dataset.folder} have no frames; name recordings of a camera.")
    if total < FEWEST:
        raise InputError(f"{dataset.folder} has {total} frames; a structure needs at least {FEWEST}, so record more.")
    chosen = set(np.linspace(0, total - 1, min(FRAMES, total)).round().astype(int).tolist())
    kept, groups, shapes, index = [], [], set(), 0
    few = len(counts) < HELD_OUT
    for number, recording in enumerate(dataset.recordings):
        for frame in recording.iter_frames():
            if index in chosen:
                kept.append(reduced(frame, LONGEST))
                groups.append(index * GROUPS // total if few else number)
                shapes.add(frame.shape[:2])
            index += 1
    if len(shapes) > 1:
        one, other = sorted(shapes)[:2]
        raise InputError(
            f"{dataset.folder} mixes frames of {one[1]}x{one[0]} and {other[1]}x{other[0]} pixels; keep one size."
        )
    shape = shapes.pop()
    pixels = np.stack(kept)
    if moving_box(pixels) is None:
        raise InputError(f"Nothing moves in the frames of {dataset.folder}; record the mechanism in motion.")
    stack = pixels.astype(np.float32) / 255
    out = np.array(groups) % HELD_OUT == HELD_OUT - 1
    reduction = -(-max(shape) // LONGEST)
    return Frames(stack[~out], stack[out], np.median(stack, axis=0), shape, reduction)
