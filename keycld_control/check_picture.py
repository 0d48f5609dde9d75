"""What `keycld check` draws: a mechanism's keypoints, rods and sliders on what its camera sees."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from keycld_control.overlay import (
    GROUND,
    INK,
    KEYPOINT,
    draw_keypoints,
    draw_pivot,
    draw_rails,
    draw_rods,
    in_picture,
)
from keycld_envs.env import KeyCLDEnv
from keycld_envs.files import atomic_file
from keycld_envs.inspection.camera import unseen_joints
from keycld_envs.inspection.constraints import values
from keycld_envs.inspection.poses import SIDE, Poses
from keycld_envs.mechanism import Mechanism
from keycld_envs.recordings import Dataset
from keycld_envs.recordings.crop import moving_box

PANEL, GAP, LINE = 384, 4, 18
"""Width and height of a panel, what is left between panels, height of a line of text, pixels."""
RANDOM = 2
"""Random poses that are drawn beside target and rest."""
UNIT, BEYOND = 1.2, 1e4
"""Width of a thin line, and the farthest column and row to draw to, pixels."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One image and what is drawn on it.

    Attributes:
        title: what it shows.
        image: [H, W, 3] uint8.
        keypoints: [K, 2] image units; NaN for those that are not known.
        lines: of text below.
        bare: nothing is drawn on it.
    """

    title: str
    image: NDArray[np.uint8]
    keypoints: NDArray[np.float64]
    lines: tuple[str, ...] = ()
    bare: bool = False


def panels(poses: Poses) -> tuple[list[Panel], list[int]]:
    """Target, rest and random poses, and the joints that move nothing in images of the model's size.

    Raises:
        InputError: if no OpenGL can be opened.
    """
    system, shown = poses.system, [len(poses.qpos) - 2, len(poses.qpos) - 1, *range(RANDOM)]
    titles = ["target", "hanging", *(f"random {i + 1}" for i in range(RANDOM))]
    found = []
    with closing(KeyCLDEnv(system)) as env:
        for index, title in zip(shown, titles, strict=True):
            keypoints = np.where(poses.depths[index, :, None] > 0, poses.keypoints[index], np.nan)
            image = env.render_qpos(poses.qpos[index], width=PANEL, height=PANEL)
            found.append(Panel(title, image, keypoints, _lines(system.mechanism, keypoints)))
        small = partial(env.render_qpos, width=SIDE, height=SIDE)
        seen, unseen = small(poses.qpos[0]), unseen_joints(poses, small)
    seen = np.repeat(np.repeat(seen, PANEL // SIDE, axis=0), PANEL // SIDE, axis=1)
    nowhere = np.full_like(poses.keypoints[0], np.nan)
    return [*found, Panel(f"random 1 as the model sees it, {SIDE} x {SIDE}", seen, nowhere, bare=True)], unseen


def recorded_panels(dataset: Dataset, mechanism: Mechanism) -> list[Panel]:
    """The first frame of four recordings, with the pivot and the box in which something moves."""
    data = dataset.sequences()
    height, width = data.frames.shape[2:4]
    box = moving_box(data.frames.reshape(-1, height, width, 3))
    found = []
    for index in np.linspace(0, len(data.frames) - 1, min(4, len(data.frames))).astype(int):
        image = Image.fromarray(data.frames[index, 0])
        if box is not None:
            ImageDraw.Draw(image).rectangle((box[0], box[1], box[2] - 1, box[3] - 1), outline=KEYPOINT)
        title = f"{dataset.recordings[index].id}, {width} x {height}"
        found.append(Panel(title, np.asarray(image), np.full((mechanism.num_keypoints, 2), np.nan)))
    return found


def draw(path: Path, mechanism: Mechanism, drawn: Sequence[Panel]) -> None:
    """Write the panels side by side.

    Args:
        path: picture to write, of a kind that its ending tells.
        mechanism: the declaration.
        drawn: from left to right.
    """
    height = PANEL + LINE * (1 + max(len(panel.lines) for panel in drawn)) + 8
    sheet = Image.new("RGB", (PANEL * len(drawn), height), GROUND)
    for column, panel in enumerate(drawn):
        sheet.paste(_panel(mechanism, panel, height), (column * PANEL, 0))
    with atomic_file(path) as file:
        sheet.save(file, format=Image.registered_extensions()[path.suffix.lower()])


def _lines(mechanism: Mechanism, keypoints: NDArray[np.float64]) -> tuple[str, ...]:
    """Every constraint's value in one pose."""
    return tuple(f"{value.name}: {value.least:.3f}" for value in values(mechanism, keypoints[None]))


def _panel(mechanism: Mechanism, panel: Panel, height: int) -> Image.Image:
    sheet = Image.new("RGB", (PANEL, height), GROUND)
    picture = Image.fromarray(panel.image).resize((PANEL - GAP, PANEL - GAP))
    if not panel.bare:
        _overlay(mechanism, panel, picture)
    sheet.paste(picture, (0, 0))
    text = ImageDraw.Draw(sheet)
    for row, line in enumerate((panel.title, *panel.lines)):
        text.text((6, PANEL + 4 + LINE * row), line, INK, ImageFont.load_default(13))
    return sheet


def _overlay(mechanism: Mechanism, panel: Panel, picture: Image.Image) -> None:
    """Draw rails, rods, pivot and keypoints."""
    pen, shape = ImageDraw.Draw(picture), panel.image.shape
    places = in_picture(panel.keypoints, shape, picture.size).clip(-BEYOND, BEYOND)
    pivot = in_picture(mechanism.pivot, shape, picture.size).clip(-BEYOND, BEYOND)
    draw_rails(pen, mechanism, pivot, 3 * PANEL, UNIT)
    draw_rods(pen, mechanism, places, pivot, UNIT)
    if any(rod.start is None for rod in mechanism.rods) or mechanism.sliders:
        draw_pivot(pen, pivot, UNIT)
    draw_keypoints(pen, places, UNIT, numbered=True)
