"""A mechanism drawn as SVG, with marks where something was found. Colours come from the page's style sheet."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.elements import Element, element
from keycld_model.diagnosis.output.page.geometry import HINGE, NEAR, Skeleton, skeleton
from keycld_model.diagnosis.output.page.labels import COLUMN, Label, Mark, column
from keycld_model.diagnosis.output.page.symbols import arrow, badge, base, cart, line, motor, point, rail, words

Array = NDArray[np.float64]
WIDTH = 480.0
"""Least width of the drawing, in units of the view box."""
MARGIN, SHORTEST, TALLEST = 38.0, 250.0, 400.0
GHOSTS, LAPSE = 4, 0.07
"""Faint earlier poses, and seconds between them."""


def draw(model: mujoco.MjModel, time: Array, q: Array, marks: Sequence[Mark]) -> Element:
    """Draw a mechanism as an SVG element.

    Args:
        model: of hinges and slides.
        time: `[n]` of a recording, s.
        q: `[n, nq]` its positions; the pose that shows most is drawn, with earlier ones behind it.
        marks: findings.
    """
    shape = skeleton(model)
    poses = _poses(shape, time, q)
    frame = _Frame.around(shape.at(poses), _reach(shape, q))
    points = frame.place(shape.at(poses))
    parts = [*_rails(shape, frame, q), *(_ghost(shape, p, i) for i, p in enumerate(points[:-1]))]
    parts += _bases(shape, points[-1]) + _links(shape, points[-1], marks) + _joints(shape, points[-1], poses[-1], marks)
    height, weight = frame.height, np.asarray(model.opt.gravity) @ shape.axes.T
    tilted = any(m.kind == "world" for m in marks)
    weight_at = _free_corner(shape, points, height, beside=tilted)
    size = float(np.linalg.norm(weight))
    if size > 1e-6:
        css = "gravity found" if tilted else "gravity"
        parts.append(arrow(weight_at, weight_at + 34 * weight / size * (1, -1), css))
        parts.append(words("g", weight_at[0] + 9, weight_at[1] + 22, "note"))
    labels = _labels(shape, points[-1], marks, weight_at + np.array([0.0, 17.0]))
    column_of_words, height = column(labels, height)
    width = max(WIDTH, *(label.right for label in labels))
    return element(
        "svg",
        element("title", "The mechanism", id="drawn"),
        element("desc", _described(model, marks), id="described"),
        *parts,
        *column_of_words,
        class_="drawing",
        viewBox=f"0 0 {width:.0f} {height:.0f}",
        role="img",
        aria_labelledby="drawn described",
    )


def _described(model: mujoco.MjModel, marks: Sequence[Mark]) -> str:
    """The drawing in words, for those who do not see it."""
    joints = ", ".join(f"{model.joint(j).name} ({_kind(model, j)})" for j in range(model.njnt))
    found = "; ".join(f"{m.title} at {m.name}" for m in marks) or "nothing"
    return f"A schematic drawing of a mechanism with the joints {joints}. Marked: {found}."


def _free_corner(shape: Skeleton, points: Array, height: float, beside: bool) -> Array:
    """Where an arrow stands apart from all poses `[..., nodes, 2]`; with `beside`, beside the labels."""
    corners = np.array([[COLUMN - 30, 22.0], [COLUMN - 30, height - 62], [22.0, 22.0], [22.0, height - 62]])
    corners = corners[:2] if beside else corners[[2, 3, 0, 1]]
    along = np.linspace(0, 1, 9)[:, None, None]
    ends = [(points[:, link.start], points[:, link.end]) for link in shape.links]
    ends.append((points[-1], points[-1] * (0, 1) + (COLUMN, 0)))  # lines to labels
    bars = np.concatenate([(a + along * (b - a)).reshape(-1, 2) for a, b in ends])
    far = np.linalg.norm(corners[:, None] + (0, 20) - bars, axis=-1).min(axis=1)
    return corners[0] if far[0] > 60 else corners[int(far.argmax())]


def _poses(shape: Skeleton, time: Array, q: Array) -> Array:
    """Earlier poses and, last, the one that shows most, `[GHOSTS + 1, nq]`."""
    good = np.flatnonzero(np.isfinite(q).all(axis=1))
    step = float(np.median(np.diff(time))) if len(time) > 1 else LAPSE
    every = max(1, round(LAPSE / step))
    tried = good[good >= GHOSTS * every][:: max(1, len(good) // 200)]
    if not len(tried):
        return np.repeat(q[good[:1]], GHOSTS + 1, axis=0)
    points = shape.at(q[tried])
    spread = np.ptp(points, axis=1)
    turned = np.linalg.norm(np.diff(points, 2, axis=1), axis=-1).sum(axis=1) if points.shape[1] > 2 else 0.0
    best = tried[int((spread.min(axis=1) + 0.3 * turned).argmax())]
    chosen = [best - i * every for i in range(GHOSTS, 0, -1)]
    return np.stack([q[i] if np.isfinite(q[i]).all() else q[best] for i in [*chosen, best]])


def _reach(shape: Skeleton, q: Array) -> Array:
    """Points of all joints that do not turn, over a recording, `[..., 2]`; rails are as long."""
    good = q[np.isfinite(q).all(axis=1)]
    slides = [j for j in range(shape.model.njnt) if shape.model.jnt_type[j] != HINGE]
    ends = [good[good[:, j].argmin()] for j in slides] + [good[good[:, j].argmax()] for j in slides]
    return shape.at(np.array(ends))[:, slides].reshape(-1, 2) if slides else np.empty((0, 2))


@dataclass(frozen=True)
class _Frame:
    """A map from metres to the view box."""

    centre: Array
    scale: float
    height: float

    @classmethod
    def around(cls, points: Array, more: Array) -> "_Frame":
        everything = np.concatenate([points.reshape(-1, 2), more])
        low, high = everything.min(axis=0), everything.max(axis=0)
        size = np.maximum(high - low, 1e-6)
        room = COLUMN - 2 * MARGIN
        scale = float(min(room / size[0], (TALLEST - 2 * MARGIN) / size[1]))
        return cls((low + high) / 2, scale, float(np.clip(scale * size[1] + 2 * MARGIN + 20, SHORTEST, TALLEST)))

    def place(self, points: Array) -> Array:
        moved = (points - self.centre) * self.scale * (1, -1)
        return moved + np.array([COLUMN / 2, self.height / 2])


def _kind(model: mujoco.MjModel, joint: int) -> str:
    return "hinge" if model.jnt_type[joint] == HINGE else "slide"


def _motors(model: mujoco.MjModel, joint: int) -> list[str]:
    """Names of the actuators of a joint."""
    kinds = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    return [
        model.actuator(i).name
        for i in range(model.nu)
        if model.actuator_trntype[i] in kinds and model.actuator_trnid[i, 0] == joint
    ]


def _drawn_links(shape: Skeleton, points: Array) -> list[tuple[int, Array, Array]]:
    """Bodies and ends of the links that are long enough to be seen."""
    least = NEAR * max(float(np.ptp(points, axis=0).max()), 1.0)
    ends = [(link.body, points[link.start], points[link.end]) for link in shape.links]
    return [(body, a, b) for body, a, b in ends if np.linalg.norm(b - a) > least]


def _thickness(shape: Skeleton, points: Array) -> float:
    lengths = [float(np.linalg.norm(b - a)) for _, a, b in _drawn_links(shape, points)]
    return float(np.clip(0.13 * min(lengths, default=100.0), 7, 15))


def _ghost(shape: Skeleton, points: Array, age: int) -> Element:
    width = _thickness(shape, points)
    lines = (line(a, b, "ghost", width) for _, a, b in _drawn_links(shape, points))
    return element("g", *lines, opacity=0.10 + 0.07 * age)


def _links(shape: Skeleton, points: Array, marks: Sequence[Mark]) -> list[Element]:
    width, out = _thickness(shape, points), []
    found = {m.name for m in marks if m.kind == "body"}
    for body, a, b in _drawn_links(shape, points):
        css = " found" if shape.model.body(body).name in found else ""
        out += [line(a, b, f"edge{css}", width + 2.5), line(a, b, f"link{css}", width)]
    ends = [points[i] for i, node in enumerate(shape.nodes) if node.joint is None]
    return [*out, *(point(end, width / 2 - 2, "end") for end in ends)]


def _rails(shape: Skeleton, frame: _Frame, q: Array) -> list[Element]:
    """Rails of slides, as long as they were used."""
    out, good = [], q[np.isfinite(q).all(axis=1)]
    for j in (j for j in range(shape.model.njnt) if shape.model.jnt_type[j] != HINGE):
        ends = frame.place(shape.at(good[[good[:, j].argmin(), good[:, j].argmax()]])[:, j])
        out.append(rail(ends[0], ends[1], shape.direction(j, good[0]) * (1, -1)))
    return out


def _bases(shape: Skeleton, points: Array) -> list[Element]:
    """Brackets under hinges that turn about the world."""
    model, out = shape.model, []
    for j in (j for j in range(model.njnt) if model.jnt_type[j] == HINGE):
        body = int(model.jnt_bodyid[j])
        fixed = not model.body_dofnum[model.body_parentid[body]] and model.body_jntadr[body] == j
        if fixed and model.body_parentid[body] == 0:
            ends = [points[link.end] for link in shape.links if link.body == body]
            below = bool(np.mean([end[1] for end in ends]) <= points[j][1])
            out.append(base(points[j], 1.0 if below else -1.0))
    return out


def _joints(shape: Skeleton, points: Array, q: Array, marks: Sequence[Mark]) -> list[Element]:
    """Carts, circles, motors, and rings where something was found."""
    model, out, width = shape.model, [], _thickness(shape, points)
    for j in range(model.njnt):
        hinge, names = model.jnt_type[j] == HINGE, _motors(model, j)
        here = [m for m in marks if (m.kind == "joint" and m.name == model.joint(j).name)]
        there = [m for m in marks if m.kind == "actuator" and m.name in names]
        along = shape.direction(j, q) * (1, -1)
        if here or there:
            out.append(point(points[j], 27, "halo"))
        if not hinge:
            out.append(cart(points[j], along))
        if names:
            out.append(motor(points[j], None if hinge else along, "motor found" if there else "motor"))
        out.append(point(points[j], width / 2 + 1.5, "joint found" if here else "joint"))
        for i, mark in enumerate([*here, *there]):
            out.append(badge(points[j] + (-21.0 + 18 * i, -21.0), mark.number))
    return out


def _labels(shape: Skeleton, points: Array, marks: Sequence[Mark], weight_at: Array) -> list[Label]:
    """Labels of joints with what was found there, then of everything else that was found."""
    model, out, used = shape.model, [], set()
    for j in range(model.njnt):
        names = _motors(model, j)
        at = {("joint", model.joint(j).name), *(("actuator", name) for name in names)}
        here = [m for m in marks if (m.kind, m.name) in at]
        used |= {m.number for m in here}
        drive = f"motor {', '.join(names)}" if names else "no motor"
        out.append(Label(points[j], model.joint(j).name, f"{_kind(model, j)}, {drive}", here))
    for mark in (m for m in marks if m.number not in used):
        anchor = weight_at if mark.kind == "world" else None
        if mark.kind == "body":
            middles = [(a + b) / 2 for body, a, b in _drawn_links(shape, points) if model.body(body).name == mark.name]
            anchor = middles[0] if middles else None
        out.append(Label(anchor, "" if mark.name in ("world", "clock") else mark.name, "", [mark]))
    return out
