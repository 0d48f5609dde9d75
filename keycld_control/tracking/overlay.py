"""The track drawn over its video."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from keycld_control.overlay import LOST, draw_keypoints, draw_pivot, draw_rods
from keycld_envs.progress import Advance
from keycld_envs.recordings.video import decode
from keycld_model.tracking import Track
from keycld_model.tracking.pendulum import Study

LONGEST = 960
"""Pixels of the longer side of the clip."""
PREDICTED = "#e0457b"


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
    pen = ImageDraw.Draw(image)
    scale = np.array([frame.shape[1], frame.shape[0]]) / track.film.size
    pivot, places = (track.pivot[t] + 0.5) * scale, (track.keypoints[t] + 0.5) * scale
    unit = max(frame.shape[:2]) / 640
    lost = [k for k, rod in enumerate(track.mechanism.rods) if not track.trusted[t, rod.end]]
    draw_rods(pen, track.mechanism, places, pivot, unit, lost)
    draw_pivot(pen, pivot, unit)
    draw_keypoints(pen, places, unit)
    if not np.isfinite(places).all():
        pen.text((8, 8), "not found", fill=LOST, font_size=round(14 * unit))
    if study is not None and track.film.times[t] >= study.split:
        x, y = (track.pixel(t, float(study.prediction[t])) + 0.5) * scale
        r = 8 * unit
        pen.ellipse((x - r, y - r, x + r, y + r), outline=PREDICTED, width=max(1, round(2 * unit)))
    return np.asarray(image)
