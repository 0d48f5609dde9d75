"""What a model sees: frames of a recording with its keypoints, and how it draws and predicts them."""

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from keycld_control.overlay import draw_keypoints, in_picture
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.world_model import CONTEXT_FRAMES

SHOWN = 8
"""Frames in a row."""
MAGNIFIED = 2
UNIT = 0.6
"""Width of a thin line, pixels of the magnified frame."""


def strip(model: WorldModel, test: Dataset, predict: bool) -> str:
    """A PNG file in base 64: frames of a recording with keypoints, drawn from these, and, if asked, predicted.

    Args:
        model: of these frames.
        test: one recording that it has not learned from.
        predict: whether the dynamics are learned, so that a prediction from the first frames tells something.
    """
    stacked = test.sequences()
    frames = stacked.frames[0]
    shown = np.linspace(0, len(frames) - 1, min(SHOWN, len(frames))).round().astype(int)
    keypoints = model.keypoints(frames[shown])
    rows = [
        [_ringed(frame, found) for frame, found in zip(frames[shown], keypoints, strict=True)],
        [_magnified(drawn) for drawn in _pixels(model.render(keypoints))],
    ]
    if predict:
        positions = model.rollout(frames[None, :CONTEXT_FRAMES], stacked.actions[:1], refine=False)[0][0]
        rows.append([_magnified(drawn) for drawn in _pixels(model.render(positions[shown]))])
    picture = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode("ascii")


def _pixels(images: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.round(255 * np.clip(np.nan_to_num(images), 0, 1)).astype(np.uint8)


def _magnified(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return frame.repeat(MAGNIFIED, axis=0).repeat(MAGNIFIED, axis=1)


def _ringed(frame: NDArray[np.uint8], keypoints: NDArray[np.floating]) -> NDArray[np.uint8]:
    """With a ring around each keypoint, image units."""
    picture = Image.fromarray(_magnified(frame))
    draw_keypoints(ImageDraw.Draw(picture), in_picture(keypoints, frame.shape, picture.size), UNIT)
    return np.asarray(picture)
