"""What `keycld discover` writes: a file that declares the mechanism, and a picture of the candidates."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from keycld_control.overlay import GROUND, INK, RAIL, draw_keypoints, draw_pivot
from keycld_envs.files import atomic_file
from keycld_envs.mechanism import Mechanism
from keycld_model.discovery import Declaration, Discovery, Placed, Structure, placed
from keycld_model.discovery.parts import Pose, ground

PANEL, LINE = 224, 20
"""Width and height of a frame, height of a line of text, pixels."""
SHOWN = 3
"""Frames of each candidate."""
COLOURS = ("#ffd23f", "#4fd1c5", "#ff8c42", "#c792ea", "#7ee787")


def write_file(path: Path, data: Path, mechanism: Mechanism, found: Discovery) -> None:
    """Write a Python file that declares a mechanism, as `keycld new --template video` does."""
    rods = ", ".join(f"Rod({rod.start}, {rod.end})" for rod in mechanism.rods)
    sliders = ", ".join(f"Slider({each.keypoint}, normal={each.normal})" for each in mechanism.sliders)
    ranking = "\n".join(f"    {each.score:.3f}  {each.name}" for each in found.ranked[:5])
    text = f'''"""A mechanism that `keycld discover {data}` found; change what you know better.

Structures by what they leave unexplained in held-out frames, and the price of their freedom, less is better:

{ranking}

    keycld check {path.name} --data {data}
    keycld train {path.name} --data {data} --out runs/{path.stem}
"""

from keycld_envs import Mechanism, Rod, Slider

# Rod(i, j) holds keypoints i and j at a constant distance, Rod(None, j) keypoint j to the pivot. Slider(k, normal)
# keeps keypoint k on a straight rail through the pivot. Image units: (0, 0) is the middle, 1 the right or upper border.
mechanism = Mechanism(
    num_keypoints={mechanism.num_keypoints},
    num_actions={mechanism.num_actions},
    rods=({rods}{"," * (len(mechanism.rods) == 1)}),
    sliders=({sliders}{"," * (len(mechanism.sliders) == 1)}),
    pivot={mechanism.pivot},
)
'''
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path, "w") as file:
        file.write(text)


def draw(path: Path, found: Discovery, declared: Declaration | None) -> None:
    """Draw the outlines of parts, and their joints, over held-out frames; the best structure with its keypoints.

    Args:
        path: picture to write, of a kind that its ending tells.
        found: the ranking.
        declared: the mechanism of the best structure; None if there is none.
    """
    rows = [each for each in found.ranked if each.parts and not each.loose][:4]
    images, background = found.held_out.images, found.frames.background
    chosen = np.linspace(0, len(images) - 1, min(SHOWN, len(images))).round().astype(int)
    sheet = Image.new("RGB", (PANEL * len(chosen), (PANEL + LINE) * max(1, len(rows))), GROUND)
    for number, structure in enumerate(rows):
        best = structure is found.best
        now = found.held_out if best else placed(images, background, structure.parts)
        keypoints = declared.keypoints(now) if best and declared is not None else None
        top = number * (PANEL + LINE)
        for column, index in enumerate(chosen):
            panel = _panel(now, int(index), None if keypoints is None else keypoints[index])
            sheet.paste(panel, (PANEL * column, top))
        _caption(ImageDraw.Draw(sheet), structure, top + PANEL)
    with atomic_file(path) as file:
        sheet.save(file, format=Image.registered_extensions()[path.suffix.lower()])


def _caption(pen: ImageDraw.ImageDraw, structure: Structure, top: int) -> None:
    text = f"{structure.score:.3f}  {structure.name}"
    pen.text((4, top + 3), text, INK, ImageFont.load_default(12))


def _panel(now: Placed, index: int, keypoints: NDArray[np.float64] | None) -> Image.Image:
    """One frame with parts as dots of their colour, joints as crosses, keypoints as rings."""
    image = Image.fromarray((now.images[index] * 255).clip(0, 255).astype(np.uint8))
    scale = PANEL / max(image.size)
    picture = Image.new("RGB", (PANEL, PANEL), GROUND)
    picture.paste(image.resize((round(image.width * scale), round(image.height * scale)), Image.Resampling.NEAREST))
    pen = ImageDraw.Draw(picture)
    for k, (part, pose) in enumerate(zip(now.parts, now.poses, strict=True)):
        if now.fits[k].gain[index] > 0:
            _dots(pen, _one(pose, index).of(part.points)[0], scale, COLOURS[k % len(COLOURS)])
    for k, part in enumerate(now.parts):
        joint = part.joint
        pose = ground(1) if joint.parent is None else _one(now.poses[joint.parent], index)
        x, y = (pose.of(np.array(joint.place))[0] + 0.5) * scale
        if joint.kind == "hinge":
            draw_pivot(pen, np.array([x, y]), 1.0)
        else:
            on_it = [other.joint.place for other in now.parts if other.joint.parent == k] or [part.points.mean(axis=0)]
            x, y = (_one(now.poses[k], index).of(np.array(on_it[0]))[0] + 0.5) * scale
            reach = 2 * PANEL * np.array([np.cos(joint.angle), np.sin(joint.angle)])
            pen.line((x - reach[0], y - reach[1], x + reach[0], y + reach[1]), RAIL, 1)
    if keypoints is not None:
        draw_keypoints(pen, (keypoints + 0.5) * scale, 1.0, numbered=True)
    return picture


def _one(pose: Pose, index: int) -> Pose:
    return Pose(pose.angle[index : index + 1], pose.origin[index : index + 1])


def _dots(pen: ImageDraw.ImageDraw, points: NDArray[np.float64], scale: float, colour: str) -> None:
    for x, y in (points + 0.5) * scale:
        pen.point((x, y), colour)


def table(ranked: Sequence[Structure]) -> list[dict[str, object]]:
    """The ranking as data."""
    return [
        {
            "structure": each.name,
            "unexplained": each.unexplained,
            "degrees_of_freedom": each.freedom,
            "score": each.score,
        }
        for each in ranked
    ]
