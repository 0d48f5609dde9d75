"""The track drawn over its video."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from keycld_envs.progress import Advance
from keycld_envs.recordings.video import decode
from keycld_model.tracking import Track
from keycld_model.tracking.pendulum import Study

LONGEST = 960
"""Pixels of the longer side of the clip."""
ROD, KEYPOINT, PIVOT, PREDICTED, LOST = "#ffd23f", "#ffd23f", "#41c7ff", "#e0457b", "#ff5a36"


def clip_size(track: Track) -> tuple[int, int]:
    """Even width and height of the clip."""
    share = min(1.0, LONGEST / max(track.film.size))
    width, height = (max(2, round(side * share) // 2 * 2) for side in track.film.size)
    return width, height


def draw_overlay(track: Track, study: Study | None, advance: Advance) -> Iterator[NDArray[np.uint8]]:
    """Every frame with rods, keypoints and pivot, and, where it was not fitted, the predicted keypoint as a ring.

    Yields:
        [h, w, 3] uint8.
    """
    size = clip_size(track)
    for t, frame in enumerate(decode(track.film.path, size)):
        yield draw_frame(frame, track, study, t)
        advance()


def draw_frame(frame: NDArray[np.uint8], track: Track, study: Study | None, t: int) -> NDArray[np.uint8]:
    """One frame of the clip's size with the track drawn over it, rods whose angles are not to be trusted in red."""
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image)
    scale = np.array([frame.shape[1], frame.shape[0]]) / track.film.size
    points = (np.vstack([track.pivot[t], *track.keypoints[t]]) + 0.5) * scale
    unit = max(frame.shape[:2]) / 640
    for k, ends in enumerate(pairwise(points)):
        if np.isfinite(ends).all():
            colour = ROD if track.trusted[t, k] else LOST
            draw.line([tuple(p) for p in ends], fill=colour, width=max(1, round(1.5 * unit)))
    _cross(draw, points[0], 6 * unit, PIVOT)
    for point in points[1:]:
        if np.isfinite(point).all():
            _ring(draw, point, 4 * unit, KEYPOINT, unit)
        else:
            draw.text((8, 8), "not found", fill=LOST, font_size=round(14 * unit))
    if study is not None and track.film.times[t] >= study.split:
        _ring(draw, (track.pixel(t, float(study.prediction[t])) + 0.5) * scale, 8 * unit, PREDICTED, 2 * unit)
    return np.asarray(image)


def _ring(draw: ImageDraw.ImageDraw, at: NDArray[np.float64], radius: float, colour: str, width: float) -> None:
    x, y = at
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=colour, width=max(1, round(width)))
    draw.point((x, y), fill=colour)


def _cross(draw: ImageDraw.ImageDraw, at: NDArray[np.float64], radius: float, colour: str) -> None:
    x, y = at
    draw.line((x - radius, y, x + radius, y), fill=colour, width=2)
    draw.line((x, y - radius, x, y + radius), fill=colour, width=2)
