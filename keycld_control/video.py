"""Clips of an episode: what the agent saw, the keypoints it found, and the energy it reckoned."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from keycld_control.closed_loop import Episode, Loop, LoopSettings, make_loop, run_episode
from keycld_control.overlay import GROUND, INK, draw_keypoints, draw_rods, in_picture
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file, check_place
from keycld_envs.mechanism import Mechanism
from keycld_envs.recordings.video import H264, write_video

SUFFIXES = (".mp4", ".gif")
PANEL, STRIP = 384, 96
"""Width and height of the image, height of the energy strip below, pixels."""
FRAME_RATE = {".mp4": 50.0, ".gif": 20.0}
DETAIL = 2  # drawn at this multiple of the size, then reduced, for smooth lines
_TARGET, CURVE = "#ffffff", "#ff8c42"


@dataclass(frozen=True)
class Moment:
    """What one frame of a clip shows.

    Attributes:
        time: seconds since the start of the episode.
        image: `[H, W, 3]` uint8, the agent's observation.
        keypoints: `[K, 2]` its estimate, image units.
        energy: learned T + V.
    """

    time: float
    image: NDArray[np.uint8]
    keypoints: NDArray[np.float32]
    energy: float


def check_clip_path(path: Path) -> None:
    """Refuse a file name that is no clip's, or where none can be.

    Raises:
        InputError: if it ends neither in .mp4 nor in .gif, or cannot be written there.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"A clip must end in {' or '.join(SUFFIXES)}, got {path}.")
    check_place(path)


def film(settings: LoopSettings, path: Path, rest: float = math.inf) -> Episode:
    """Run the first episode of `settings` and write a clip of it, in real time.

    Args:
        settings: what to run.
        path: the clip, ending in .mp4 (H.264, 50 frames/s) or .gif (20 frames/s).
        rest: seconds at the target after which the clip ends; by default it shows the whole episode.

    Raises:
        InputError: as `make_loop`, or if the path has another ending.
    """
    check_clip_path(path)
    with make_loop(settings) as loop:
        timestep = loop.env.system.timestep
        rate = min(FRAME_RATE[path.suffix.lower()], 1 / timestep)
        every = max(1, round(1 / (rate * timestep)))
        episode, moments = record(loop, settings.seed, rest)
        mechanism, agent = loop.env.system.mechanism, loop.agent
        pictures = draw_clip(moments[::every], mechanism, agent.target, agent.pivot, agent.target_energy)
        write_clip(path, pictures, 1 / (every * timestep))
    return episode


def record(loop: Loop, seed: int, rest: float) -> tuple[Episode, list[Moment]]:
    """Run an episode and keep every step of it until it has rested at the target for `rest` seconds."""
    moments: list[Moment] = []

    def watch(image: NDArray[np.uint8], time: float) -> None:
        moments.append(Moment(time, image, loop.agent.keypoints, loop.agent.energy))

    episode = run_episode(loop, seed, watch)
    return episode, [moment for moment in moments if moment.time <= episode.upright_s + rest]


def draw_clip(
    moments: list[Moment],
    mechanism: Mechanism,
    target: NDArray[np.float32],
    pivot: NDArray[np.float32],
    target_energy: float,
    panel: int = PANEL,
    strip: int = STRIP,
    label: str = "learned energy T + V;  dashed: at the target;",
) -> Iterator[NDArray[np.uint8]]:
    """Draw every moment: the image with keypoints and rods, the target as rings, the energy so far below.

    Args:
        moments: in order of time.
        mechanism: tells which keypoints rods connect.
        target: `[K, 2]` target keypoints, image units.
        pivot: `[2]`, image units.
        target_energy: learned energy at rest at the target.
        panel: width and height of the image, pixels.
        strip: height of the energy strip below, pixels.
        label: text in the strip, before the time.

    Yields:
        `[panel + strip, panel, 3]` uint8.
    """
    energies = np.array([moment.energy for moment in moments])
    low, high = min(energies.min(), target_energy), max(energies.max(), target_energy)
    heights = 1 - (np.append(energies, target_energy) - low) / max(high - low, 1e-9)
    last = max(moments[-1].time, 1e-9)
    curve = [((moment.time / last), height) for moment, height in zip(moments, heights[:-1], strict=True)]
    for i, moment in enumerate(moments):
        canvas = Image.new("RGB", (DETAIL * panel, DETAIL * (panel + strip)), GROUND)
        canvas.paste(Image.fromarray(moment.image).resize((DETAIL * panel, DETAIL * panel), Image.Resampling.NEAREST))
        draw = ImageDraw.Draw(canvas)
        _draw_target(draw, target, moment.image.shape, panel)
        draw_mechanism(draw, mechanism, moment.keypoints, pivot, moment.image.shape, panel)
        text = f"{label}  {moment.time:4.1f} s"
        _draw_energy(draw, curve[: i + 1], float(heights[-1]), text, panel, strip)
        yield np.asarray(canvas.resize((panel, panel + strip), Image.Resampling.BOX))


def write_clip(path: Path, pictures: Iterator[NDArray[np.uint8]], frame_rate: float) -> None:
    """Write pictures `[H, W, 3]` uint8 of even size as .mp4 or .gif; the file appears only when complete.

    Raises:
        InputError: if it could not be written whole.
    """
    with atomic_file(path) as file:
        if path.suffix.lower() == ".gif":
            images = [Image.fromarray(picture).quantize(256, dither=Image.Dither.NONE) for picture in pictures]
            milliseconds = round(1000 / frame_rate)
            images[0].save(
                file, "GIF", save_all=True, append_images=images[1:], duration=milliseconds, loop=0, optimize=True
            )
            return
        first = next(pictures)
        write_video(
            Path(file.name),
            chain([first], pictures),
            (first.shape[1], first.shape[0]),
            frame_rate,
            **H264,
        )


def draw_mechanism(
    pen: ImageDraw.ImageDraw,
    mechanism: Mechanism,
    points: NDArray[np.float32],
    pivot: NDArray[np.float32],
    shape: tuple[int, ...],
    panel: int,
) -> None:
    """Keypoints and rods on an image that was enlarged to a canvas.

    Args:
        pen: of the canvas, `DETAIL * panel` pixels wide and high.
        mechanism: tells which keypoints rods connect.
        points: `[K, 2]` keypoints, image units.
        pivot: `[2]`, image units.
        shape: of the image, (H, W, ...).
        panel: width and height of the picture that the canvas becomes, pixels.
    """
    places, origin = (in_picture(each, shape, (DETAIL * panel, DETAIL * panel)) for each in (points, pivot))
    draw_rods(pen, mechanism, places, origin, DETAIL)
    draw_keypoints(pen, places, DETAIL, filled=True)


def _draw_target(pen: ImageDraw.ImageDraw, target: NDArray[np.float32], shape: tuple[int, ...], panel: int) -> None:
    r = 8 * DETAIL
    for x, y in in_picture(target, shape, (DETAIL * panel, DETAIL * panel)):
        pen.ellipse((x - r, y - r, x + r, y + r), outline=_TARGET, width=DETAIL)


def _draw_energy(
    draw: ImageDraw.ImageDraw, curve: list[tuple[float, float]], target: float, text: str, panel: int, strip: int
) -> None:
    """The curve, in shares of the strip's width and height, and the target's level as a dashed line."""
    margin, top = 10 * DETAIL, (panel + 24) * DETAIL
    width, height = panel * DETAIL - 2 * margin, (strip - 34) * DETAIL
    level = top + target * height
    for x in range(margin, margin + width, 12 * DETAIL):
        draw.line((x, level, x + 6 * DETAIL, level), fill=INK, width=DETAIL)
    line = [(margin + x * width, top + y * height) for x, y in curve]
    if len(line) > 1:
        draw.line(line, fill=CURVE, width=2 * DETAIL, joint="curve")
    x, y = line[-1]
    draw.ellipse((x - 3 * DETAIL, y - 3 * DETAIL, x + 3 * DETAIL, y + 3 * DETAIL), fill=CURVE)
    draw.text((margin, (panel + 4) * DETAIL), text, fill=INK, font_size=11 * DETAIL)
