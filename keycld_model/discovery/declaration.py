"""Keypoints, rods and sliders of a structure that was found."""

from dataclasses import dataclass

import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_model.discovery.charts import Points
from keycld_model.discovery.frames import Frames
from keycld_model.discovery.parts import Part, Placed, Pose, ground, raster
from keycld_model.discovery.structure import PRICE, Discovery
from keycld_model.sampling import connected, grown

SAME = 2.0
"""Pixels; joints closer than that are at one place."""
END = 0.9
"""Share of a part's points that are nearer to its hinge than its end."""
STILL_ANGLE, STILL_PIXELS = 0.3, 3.0
"""rad, pixels; a part whose motion varies less does not show well what it turns about, or slides along."""
COVERED = 0.3
"""Share of frames in which a part may not be seen before that is said."""


@dataclass(frozen=True)
class Node:
    """A place that becomes a keypoint, or the pivot.

    Attributes:
        part: index of the part whose frame it is in; None for the ground.
        place: in that frame, pixels.
    """

    part: int | None
    place: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Declaration:
    """A mechanism, and where its keypoints are.

    Attributes:
        mechanism: keypoints, rods, sliders and pivot.
        nodes: of each keypoint.
    """

    mechanism: Mechanism
    nodes: tuple[Node, ...]

    def keypoints(self, found: Placed) -> Points:
        """[N, K, 2], pixels of the frames in which parts were found."""
        return np.stack([position(found, node) for node in self.nodes], axis=1)


def position(found: Placed, node: Node) -> Points:
    """[N, 2], where a place is in every frame, pixels."""
    pose: Pose = ground(len(found.images)) if node.part is None else found.poses[node.part]
    return pose.of(np.array(node.place))


def declare(parts: tuple[Part, ...], frames: Frames, num_actions: int) -> Declaration:
    """The mechanism of parts on joints: a keypoint where the next part is joined, or at the end of the last.

    Args:
        parts: each after its parent.
        frames: in which they were found; for image units.
        num_actions: number of actuators.

    Raises:
        InputError: if a Mechanism cannot say it: nothing moves, or parts are on the ground at several places.
    """
    if not parts:
        raise InputError("No part was found that turns or slides; record more motion, or name frames that show it.")
    nodes: list[Node] = []
    own: dict[int, list[int]] = {}
    for k, part in enumerate(parts):
        own[k] = []
        for place in _places(parts, k, part):
            own[k].append(len(nodes))
            nodes.append(Node(k, place))
    rods, sliders = [], []
    for k, part in enumerate(parts):
        if part.joint.kind == "hinge":
            start = _start(part, nodes, own)
            rods += [Rod(start, end) for end in own[k]]
        else:
            normal = _normal(part.joint.angle)
            sliders += [Slider(node, normal) for node in own[k]]
        rods += [Rod(own[k][0], other) for other in own[k][1:]]
    pivot = frames.to_image(_pivot(parts, nodes, own, frames))
    where = (round(float(pivot[0]), 3) + 0.0, round(float(pivot[1]), 3) + 0.0)
    return Declaration(Mechanism(len(nodes), num_actions, tuple(rods), tuple(sliders), where), tuple(nodes))


def _places(parts: tuple[Part, ...], k: int, part: Part) -> list[tuple[float, float]]:
    """Where other parts are joined to part k, or its end."""
    found: list[tuple[float, float]] = []
    for other in parts:
        if other.joint.parent == k and not any(_near(other.joint.place, place) for place in found):
            found.append(other.joint.place)
    if found:
        return found
    points = part.points
    if part.joint.kind == "slide":
        x, y = points.mean(axis=0)
    else:  # nodes of a polar grid are the denser the nearer
        mask, index, _ = raster(points, 1)
        pieces, number = connected(grown(mask, 1))
        piece = pieces[tuple(index.T)]
        weight = np.bincount(piece, weights=np.hypot(*points.T), minlength=number + 1)
        points = points[piece == weight.argmax()]
        radius = np.hypot(*points.T)
        order = np.argsort(radius)
        mass = np.cumsum(radius[order]) / radius.sum()
        end = points[order[mass >= END]]
        x, y = end.mean(axis=0)
    return [(float(x), float(y))]


def _near(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return float(np.hypot(*np.subtract(one, other))) < SAME


def _start(part: Part, nodes: list[Node], own: dict[int, list[int]]) -> int | None:
    """The keypoint that a hinge is at; None for the ground."""
    parent = part.joint.parent
    if parent is None:
        return None
    return next(node for node in own[parent] if _near(nodes[node].place, part.joint.place))


def _normal(angle: float) -> tuple[float, float]:
    """Image units (y up), at right angles to a rail, pointing up."""
    x, y = np.sin(angle), np.cos(angle)
    sign = -1.0 if y < -1e-9 else 1.0
    return round(sign * float(x), 4) + 0.0, round(sign * float(y), 4) + 0.0


def _pivot(parts: tuple[Part, ...], nodes: list[Node], own: dict[int, list[int]], frames: Frames) -> Points:
    """The one place of the ground that all hinges on it, and all rails, go through, pixels."""
    hinges = [np.array(part.joint.place) for part in parts if part.joint.parent is None and part.joint.kind == "hinge"]
    rails = []
    for k, part in enumerate(parts):
        if part.joint.kind == "slide":
            along = np.array([np.cos(part.joint.angle), np.sin(part.joint.angle)])
            across = np.array([-along[1], along[0]])
            for node in own[k]:
                x, y = nodes[node].place
                rails.append((np.array(part.joint.place) + x * along + y * across, along))
    middle = (np.array(frames.background.shape[1::-1]) - 1) / 2
    start, along = rails[0] if rails else (middle, np.zeros(2))
    pivot = hinges[0] if hinges else start + along * ((middle - start) @ along)
    off = [np.hypot(*(hinge - pivot)) for hinge in hinges]
    off += [abs((pivot - start)[0] * along[1] - (pivot - start)[1] * along[0]) for start, along in rails]
    if max(off) > SAME:
        raise InputError(
            f"The structure has joints on the ground at places {max(off):.0f} pixels apart, but a mechanism has one "
            "pivot; declare the part that you need by hand, `keycld new my_arm --template video` writes a file for it."
        )
    return pivot


def doubts(found: Discovery) -> list[str]:
    """What the frames cannot tell, a sentence each."""
    said, now = [], found.fitted
    for k, (part, fit) in enumerate(zip(now.parts, now.fits, strict=True)):
        shift, hidden = fit.shift[fit.gain > 0], float((fit.gain <= 0).mean())
        hinge = part.joint.kind == "hinge"
        middle = np.angle(np.exp(1j * shift).mean()) if hinge else shift.mean()
        away = np.angle(np.exp(1j * (shift - middle))) if hinge else shift - middle
        if np.std(away) < (STILL_ANGLE if hinge else STILL_PIXELS):
            amount = f"{np.std(away):.2f} rad" if hinge else f"{np.std(away):.1f} pixels"
            said.append(
                f"Part {k} moves little (rms {amount}), so that its joint is uncertain; record more motion of it."
            )
        if hidden > COVERED:
            said.append(
                f"Part {k} is covered, or outside the image, in {100 * hidden:.0f} % of frames; record it in view."
            )
    if found.best.unexplained > 2 * PRICE + _BLUR:
        said.append(
            f"{100 * found.best.unexplained:.0f} % of what moves is explained by no part: something that neither turns "
            "nor slides, or changes its look; see the picture."
        )
    return said + [
        f"Part {each.loose[0]}'s joint does not hold: let loose, it explains "
        f"{100 * (found.best.unexplained - each.unexplained):.0f} % more; it may be on something that is not seen."
        for each in found.ranked
        if each.loose and each.score < found.best.score
    ]


_BLUR = 0.25
"""What drawing at the resolution of frames leaves at edges, of thin parts."""
