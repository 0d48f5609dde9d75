"""Figures 4 and 13 to 15: every fourth frame of a recording above what a model predicts."""

from pathlib import Path

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray

from keycld_envs.files import atomic_file
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.world_model import CONTEXT_FRAMES

EVERY, FRAMES = 4, 50


def strip(model: WorldModel, test: Dataset, index: int = 0) -> NDArray[np.uint8]:
    """Image `[2H, nW, 3]`: frames of a recording, and below them those predicted from its first five."""
    stacked = test.sequences()
    frames, actions = stacked.frames[index, :FRAMES], stacked.actions[index, : FRAMES - 1]
    predicted = model.predict(frames[:CONTEXT_FRAMES], actions, len(frames)).frames
    drawn = np.round(255 * np.clip(np.nan_to_num(predicted), 0, 1)).astype(np.uint8)
    rows = [np.concatenate(list(row[::EVERY]), axis=1) for row in (frames, drawn)]
    return np.concatenate(rows)


def write_strip(path: Path, model: WorldModel, test: Dataset) -> None:
    """As a PNG file."""
    picture = iio.imwrite("<bytes>", strip(model, test), extension=".png")
    with atomic_file(path) as file:
        file.write(picture)
