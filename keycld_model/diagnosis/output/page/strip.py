"""A strip of frames with links drawn over them."""

import base64
import io
from collections.abc import Sequence

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.elements import Element, element
from keycld_model.diagnosis.verdict.evidence import Picture

KINDS = ("measured", "refitted", "corrected")
"""Classes of the three sets of links, in their order."""
NUMBER = 8
"""Frames of the strip."""


def strip(pictures: Sequence[Picture]) -> list[tuple[str, Element]]:
    """A caption and a drawing of some of the pictures, from the first to the last."""
    chosen = sorted({int(k) for k in np.linspace(0, len(pictures) - 1, NUMBER).round()}) if pictures else []
    return [(f"{pictures[k].time:.2f} s", _tile(pictures[k])) for k in chosen]


def _tile(picture: Picture) -> Element:
    height, width = picture.frame.shape[:2]
    data = element(
        "image", x=0, y=0, width=width, height=height, href=_png(picture.frame), style="image-rendering:auto"
    )
    lines = [
        element("line", x1=a[0] + 0.5, y1=a[1] + 0.5, x2=b[0] + 0.5, y2=b[1] + 0.5, class_=f"bar {kind}")
        for kind, links in reversed(list(zip(KINDS, picture.links, strict=True)))
        for a, b in links
        if np.isfinite([a, b]).all()
    ]
    return element("svg", data, *lines, viewBox=f"0 0 {width} {height}", role="img", aria_label="Frame with links")


def _png(frame: NDArray[np.uint8]) -> str:
    with io.BytesIO() as file:
        iio.imwrite(file, frame, extension=".png")
        return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
