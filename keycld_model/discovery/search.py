"""The joint on which one part more explains most."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from keycld_model.discovery.charts import Array, Chart
from keycld_model.discovery.parts import ANGLES, Joint, Placed, chart_of, raster, size_of
from keycld_model.discovery.shapes import Alternation, Fit, resampled

STEP = 3
"""Pixels between hinges that are tried, or fewer if a mechanism is small."""
RAILS = 12
"""Directions of rails that are tried."""
COARSE_FRAMES, FINE_FRAMES = 40, 64
"""Frames with which joints are tried, at half their resolution, and with which the best is placed."""
STARTS = 2
"""Frames from which a shape is started."""
KEPT = 3
"""Joints that are looked at closely."""
CHANGED = 0.1
"""Difference of colour (0 to 1) that something moving makes at least."""
REACH = 3
"""Pixels from a part within which hinges on it are sought."""
MOVES = 3
"""Steps of one length by which a joint's place is improved."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A joint for one part more.

    Attributes:
        joint: what the part may do.
        fit: the part.
        chart: of its grid.
        reduction: pixels of the frames per pixel of the grid.
        share: of the squared error of everything that moves, by which it reduces it.
    """

    joint: Joint
    fit: Fit
    chart: Chart
    reduction: int
    share: float


def joints(now: Placed) -> list[Joint]:
    """All joints that are tried for the next part: those with which a `Mechanism` can declare it.

    The first part is on the ground. Others are on a part, or where one is on the ground: a mechanism has one pivot.
    """
    if not now.parts:
        return _on_ground(now)
    found = list(dict.fromkeys(part.joint for part in now.parts if part.joint.parent is None))
    for k, part in enumerate(now.parts):
        mask, _, low = raster(part.points, REACH)
        for x, y in _grid(_near(mask)):
            place = (x + float(low[0]), y + float(low[1]))
            if part.joint.kind == "slide" or np.hypot(*place) > REACH:
                found.append(Joint("hinge", k, place))
    return found


def _on_ground(now: Placed) -> list[Joint]:
    """Hinges near what moves, and rails of all directions."""
    change = ((now.images - now.background) ** 2).sum(axis=-1) > CHANGED**2
    near = _near(change.mean(axis=0) > 0.01)
    height, width = now.background.shape[:2]
    middle = ((width - 1) / 2, (height - 1) / 2)
    rails = [Joint("slide", None, middle, float(angle)) for angle in np.arange(RAILS) * np.pi / RAILS]
    return [*(Joint("hinge", None, place) for place in _grid(near)), *rails]


def _near(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask and all within `REACH` of it."""
    return cast(NDArray[np.bool_], ndimage.maximum_filter(mask, 2 * REACH + 1))


def _grid(mask: NDArray[np.bool_]) -> Iterator[tuple[float, float]]:
    offset = STEP // 2
    rows, columns = np.nonzero(mask[offset::STEP, offset::STEP])
    for row, column in zip(rows, columns, strict=True):
        yield float(column * STEP + offset), float(row * STEP + offset)


def candidates(now: Placed) -> list[Candidate]:
    """The joints that explain most, the best first; all but the best are placed roughly.

    Args:
        now: what is known.
    """
    moving = float(((now.images - now.background) ** 2).sum())
    coarse = _Level.of(now, COARSE_FRAMES, 2, moving)
    tried = [coarse.look(joint) for joint in joints(now)]
    there = {part.joint for part in now.parts}
    near = [each if each.joint in there else _refined(coarse, each, STEP / 2, 2) for each in _distinct(tried)]
    close = sorted(near, key=lambda each: -each.share)
    if close[0].joint not in there:
        close[0] = _refined(_Level.of(now, FINE_FRAMES, 1, moving), close[0], STEP / 4, 2)
    return _distinct([replace(each, joint=_simplest(now, each.joint)) for each in close])


def _simplest(now: Placed, joint: Joint) -> Joint:
    """A hinge at the hinge of its parent is one on what the parent is on."""
    while joint.parent is not None and now.parts[joint.parent].joint.kind == "hinge" and np.hypot(*joint.place) < STEP:
        joint = now.parts[joint.parent].joint
    return joint


@dataclass(frozen=True, eq=False)
class _Level:
    """Frames of one resolution, in which joints are tried.

    Attributes:
        now: what is known.
        some: [n], frames that are looked at.
        stack: [n, h, w, 6], these and what is known of them.
        reduction: pixels of the frames per pixel here.
        starts: frames from which a shape is started.
        moving: squared error of everything that moves, in as many frames.
    """

    now: Placed
    some: NDArray[np.intp]
    stack: Array
    reduction: int
    starts: list[int]
    moving: float

    @classmethod
    def of(cls, now: Placed, frames: int, reduction: int, moving: float) -> "_Level":
        number = len(now.images)
        some = np.linspace(0, number - 1, min(frames, number)).round().astype(int)
        left = np.argsort(-now.unexplained[some])
        starts = [int(left[len(left) * (i + 1) // 4]) for i in range(STARTS)]
        stack = now.stack()[some]
        if reduction > 1:
            height, width = (side // reduction for side in stack.shape[1:3])
            stack = stack[:, : height * reduction, : width * reduction]
            stack = stack.reshape(len(some), height, reduction, width, reduction, 6).mean(axis=(2, 4))
        return cls(now, some, stack, reduction, starts, moving * len(some) / number)

    def look(self, joint: Joint, like: Candidate | None = None) -> Candidate:
        """The best part on a joint, or the one that is like another's."""
        size = size_of(joint, self.stack.shape[1:3], ANGLES // 2 // self.reduction)
        chart = chart_of(joint, self.now.parent(joint), size)
        origin = (chart.origin[self.some] + 0.5) / self.reduction - 0.5
        chart = Chart(origin, None if chart.along is None else chart.along[self.some], size)
        frames = Alternation(self.stack, chart)
        if like is None:
            fit = frames.fit(self.starts)
        else:
            fit = frames.refine(resampled(like.fit.shape, like.chart, chart, like.reduction / self.reduction), 2)
        return Candidate(joint, fit, chart, self.reduction, fit.total * self.reduction**2 / self.moving)


def _refined(level: _Level, candidate: Candidate, step: float, steps: int) -> Candidate:
    """The joint moved to where it explains most."""
    best = level.look(candidate.joint, candidate)
    for _ in range(steps):
        for _ in range(MOVES):
            new = max((level.look(joint, best) for joint in _around(best.joint, step)), key=lambda each: each.share)
            if new.share <= best.share:
                break
            best = new
        step /= 2
    return best


def _distinct(tried: list[Candidate]) -> list[Candidate]:
    """The best ones that are not beside a better one."""
    kept: list[Candidate] = []
    for each in sorted(tried, key=lambda each: -each.share):
        if len(kept) < KEPT and not any(_beside(each.joint, other.joint) for other in kept):
            kept.append(each)
    return kept


def _beside(one: Joint, other: Joint) -> bool:
    if (one.kind, one.parent) != (other.kind, other.parent):
        return False
    if one.kind == "slide":
        return abs((one.angle - other.angle + np.pi / 2) % np.pi - np.pi / 2) < 0.6
    return float(np.hypot(*np.subtract(one.place, other.place))) < 2 * STEP


def _around(joint: Joint, step: float) -> list[Joint]:
    if joint.kind == "slide":
        return [replace(joint, angle=joint.angle + sign * np.radians(4 * step)) for sign in (-1, 1)]
    x, y = joint.place
    return [replace(joint, place=(x + dx, y + dy)) for dx, dy in ((-step, 0), (step, 0), (0, -step), (0, step))]
