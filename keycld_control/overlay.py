"""How keypoints, rods, rails and pivots look on pictures and in clips: the same everywhere."""

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import ImageDraw, ImageFont

from keycld_envs.mechanism import Mechanism

KEYPOINT, PIVOT, RAIL, LOST, INK, GROUND = "#ffd23f", "#41c7ff", "#ff8c42", "#ff5a36", "#c8cdd3", "#15191e"
Places = NDArray[np.float64]


def in_picture(points: ArrayLike, shape: tuple[int, ...], size: tuple[int, int]) -> Places:
    """Where points of an image are in a picture that it fills.

    Args:
        points: `[..., 2]` image units; -1 and 1 are the centres of the outermost pixels, y up.
        shape: of the image, (H, W, ...).
        size: (W, H) of the picture, pixels.

    Returns:
        `[..., 2]` column and row, pixels from the picture's upper left corner.
    """
    image = np.array([shape[1], shape[0]])
    pixels = (np.asarray(points) * [1, -1] + 1) / 2 * (image - 1)
    return (pixels + 0.5) / image * size


def draw_rods(
    pen: ImageDraw.ImageDraw,
    mechanism: Mechanism,
    places: Places,
    pivot: Places,
    unit: float,
    lost: Collection[int] = (),
) -> None:
    """Rods whose ends are known.

    Args:
        pen: of the picture.
        mechanism: tells which keypoints rods connect.
        places: `[K, 2]` keypoints, pixels; NaN where unknown.
        pivot: `[2]`, pixels.
        unit: width of a thin line, pixels.
        lost: rods that are not to be trusted, by index.
    """
    for k, rod in enumerate(mechanism.rods):
        ends = np.array([pivot if rod.start is None else places[rod.start], places[rod.end]])
        if np.isfinite(ends).all():
            pen.line([*ends.ravel()], LOST if k in lost else KEYPOINT, max(1, round(1.5 * unit)))


def draw_rails(pen: ImageDraw.ImageDraw, mechanism: Mechanism, pivot: Places, reach: float, unit: float) -> None:
    """Rails through the pivot, so many pixels to both sides."""
    for slider in mechanism.sliders:
        along = reach * np.array([slider.along[0], -slider.along[1]])
        pen.line([*(pivot - along), *(pivot + along)], RAIL, max(1, round(unit)))


def draw_pivot(pen: ImageDraw.ImageDraw, at: Places, unit: float) -> None:
    """A cross."""
    (x, y), arm, width = at, 6 * unit, max(1, round(1.5 * unit))
    pen.line((x - arm, y, x + arm, y), PIVOT, width)
    pen.line((x, y - arm, x, y + arm), PIVOT, width)


def draw_keypoints(
    pen: ImageDraw.ImageDraw, places: Places, unit: float, *, numbered: bool = False, filled: bool = False
) -> None:
    """Rings or discs of keypoints that are known.

    Args:
        pen: of the picture.
        places: `[K, 2]` pixels; NaN where unknown.
        unit: width of a thin line, pixels.
        numbered: with their index beside them.
        filled: discs, not rings.
    """
    radius, width = 5 * unit, max(1, round(1.5 * unit))
    for k, (x, y) in enumerate(places):
        if not np.isfinite((x, y)).all():
            continue
        box = (x - radius, y - radius, x + radius, y + radius)
        if filled:
            pen.ellipse(box, fill=KEYPOINT, outline=GROUND, width=max(1, round(unit)))
        else:
            pen.ellipse(box, outline=KEYPOINT, width=width)
            pen.point((x, y), KEYPOINT)
        if numbered:
            beside, font = (x + 8 * unit, y - 8 * unit), ImageFont.load_default(round(15 * unit))
            pen.text(beside, str(k), KEYPOINT, font, stroke_width=2, stroke_fill=GROUND)
