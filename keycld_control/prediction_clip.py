"""Clips of predictions: what was recorded, what the model expects from the first frames on, and where they part."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from keycld_control.overlay import GROUND, INK
from keycld_control.video import DETAIL, PANEL, check_clip_path, draw_mechanism, write_clip
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.evaluation import counted_sequences

CAPTION = 24
"""Height of the caption below the images, pixels."""
SLOWER = 2
"""Times slower than real, so that people can follow."""


def film_predictions(
    model: WorldModel, dataset: Dataset, path: Path, context: int, frames: int, sequences: int = 6
) -> None:
    """Write a clip of the first few sequences that an evaluation counts, one after the other.

    On the left what was recorded, with the predicted keypoints drawn in; on the right what the model draws of them.

    Args:
        model: the model.
        dataset: recordings; of the model's own training set only the held-out part is used.
        path: the clip, ending in .mp4 or .gif.
        context: frames that each prediction starts from.
        frames: recordings are cut into sequences of at most this many frames.
        sequences: how many to show.

    Raises:
        InputError: as `evaluate`, or if the path has another ending.
    """
    check_clip_path(path)
    stacked = counted_sequences(model, dataset, frames)
    chosen = np.unique(np.linspace(0, len(stacked.frames) - 1, sequences).round().astype(int))
    pictures = (
        picture for i in chosen for picture in draw_prediction(model, stacked.frames[i], stacked.actions[i], context)
    )
    write_clip(path, pictures, 1 / (SLOWER * model.timestep))


def draw_prediction(
    model: WorldModel, frames: NDArray[np.uint8], actions: NDArray[np.float64], context: int, panel: int = PANEL
) -> Iterator[NDArray[np.uint8]]:
    """Draw a recorded sequence `[T, H, W, 3]` beside its prediction from the first `context` frames.

    Yields:
        `[panel + CAPTION, 2 panel, 3]` uint8.
    """
    predicted = model.predict(frames[:context], actions, len(frames))
    drawn = (255 * np.clip(predicted.frames, 0, 1)).astype(np.uint8)
    for k, (recorded, expected, points) in enumerate(zip(frames, drawn, predicted.keypoints, strict=True)):
        canvas = Image.new("RGB", (2 * DETAIL * panel, DETAIL * (panel + CAPTION)), GROUND)
        for column, image in enumerate((recorded, expected)):
            enlarged = Image.fromarray(image).resize((DETAIL * panel, DETAIL * panel), Image.Resampling.NEAREST)
            canvas.paste(enlarged, (column * DETAIL * panel, 0))
        draw = ImageDraw.Draw(canvas)
        draw_mechanism(draw, model.mechanism, points, model.pivot, recorded.shape, panel)
        ahead = (k - context + 1) * model.timestep
        texts = f"recorded;  {'given' if ahead <= 0 else f'predicted {ahead:.2f} s ahead'}", "what the model expects"
        for column, text in enumerate(texts):
            place = ((10 + column * panel) * DETAIL, (panel + 5) * DETAIL)
            draw.text(place, text, fill=INK, font_size=11 * DETAIL)
        yield np.asarray(canvas.resize((2 * panel, panel + CAPTION), Image.Resampling.BOX))
