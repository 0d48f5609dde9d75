"""Frames with links drawn over them, moving: a clip inside the page."""

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from keycld_envs.recordings.video import H264, write_video
from keycld_model.diagnosis.verdict.evidence import Picture

SIDE = 384
"""Pixels of the clip's longer side, about."""
LINES = (("#ffe14d", 0.014), ("#e3ad49", 0.006), ("#6db3ea", 0.006))
"""Colours and widths, parts of the longer side, of links as seen, refitted and corrected: what agrees lies inside."""
DETAIL = 2
"""By which the picture is larger while lines are drawn, for smooth edges."""


def film(pictures: Sequence[Picture]) -> str:
    """A clip in real time as a `data:` address, H.264; empty if there are not two pictures."""
    if len(pictures) < 2:
        return ""
    height, width = pictures[0].frame.shape[:2]
    factor = 2 * max(1, SIDE // (2 * max(height, width)))  # H.264 has even sides only
    rate = 1 / float(np.median(np.diff([picture.time for picture in pictures])))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_video(path, _drawn(pictures, factor), (factor * width, factor * height), rate, **H264)
        return "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode()


def _drawn(pictures: Sequence[Picture], factor: int) -> Iterator[NDArray[np.uint8]]:
    for picture in pictures:
        height, width = picture.frame.shape[:2]
        size = factor * width, factor * height
        canvas = Image.fromarray(picture.frame).resize((DETAIL * size[0], DETAIL * size[1]), Image.Resampling.BICUBIC)
        pen = ImageDraw.Draw(canvas)
        for (colour, part), links in zip(LINES, picture.links, strict=True):
            for ends in links[np.isfinite(links).all((1, 2))]:
                places = [tuple(end) for end in (ends + 0.5) * factor * DETAIL]
                pen.line(places, fill=colour, width=max(1, round(part * DETAIL * max(size))))
        yield np.asarray(canvas.resize(size, Image.Resampling.BOX))
