"""A mechanism's parts, each on a joint to the ground or to a part before it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from keycld_model.discovery.charts import Array, Chart, Points, own_chart
from keycld_model.discovery.shapes import Alternation, Fit, Shape, draw

ANGLES = 128
"""Nodes of a full turn."""
SWEEPS = 1
"""Times that every part is placed anew when all others are known."""


@dataclass(frozen=True)
class Joint:
    """What a part may do.

    Attributes:
        kind: "hinge" or "slide".
        parent: index of the part it is on, None for the ground.
        place: of the hinge in its parent's frame, or of zero of the rail on the ground, pixels.
        angle: of the rail, rad from x (right) to y (down); 0 for a hinge.
    """

    kind: Literal["hinge", "slide"]
    parent: int | None
    place: tuple[float, float]
    angle: float = 0.0


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a part's frame is.

    Attributes:
        angle: [N] rad, from x (right) to y (down).
        origin: [N, 2] pixels.
    """

    angle: Points
    origin: Points

    def of(self, place: Points) -> Points:
        """[N, ..., 2], points [..., 2] of the part's frame in every frame's image, pixels."""
        c, s = (f(self.angle).reshape(-1, *(1,) * (place.ndim - 1)) for f in (np.cos, np.sin))
        turned = np.stack([c * place[..., 0] - s * place[..., 1], s * place[..., 0] + c * place[..., 1]], axis=-1)
        return turned + self.origin.reshape(-1, *(1,) * (place.ndim - 1), 2)


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid part.

    Attributes:
        joint: what it may do.
        shape: how it looks.
        size: of its grid.
    """

    joint: Joint
    shape: Shape
    size: tuple[int, int]

    @cached_property
    def points(self) -> Points:
        """[n, 2] its places in its own frame, pixels."""
        return own_chart(self.size, circular=self.joint.kind == "hinge").offsets()[self.shape.there > 0]


def raster(points: Points, margin: int) -> tuple[NDArray[np.bool_], NDArray[np.intp], Points]:
    """Points [n, 2] on a grid of whole pixels.

    Returns:
        [h, w], whether there is one in each pixel; [n, 2], row and column of each; [2], the grid's first pixel (x, y).
    """
    low = points.min(axis=0) - margin
    index = np.rint(points - low).astype(int)[:, ::-1]
    mask = np.zeros(index.max(axis=0) + margin + 1, bool)
    mask[tuple(index.T)] = True
    return mask, index, low


def ground(number: int) -> Pose:
    """The pose of the image itself."""
    return Pose(np.zeros(number), np.zeros((number, 2)))


def chart_of(joint: Joint, parent: Pose, size: tuple[int, int]) -> Chart:
    """The chart in which a joint's motion is a shift, for frames in which its parent has a pose."""
    origin = parent.of(np.array(joint.place))
    if joint.kind == "hinge":
        return Chart(origin, None, size)
    angle = parent.angle + joint.angle
    return Chart(origin, np.stack([np.cos(angle), np.sin(angle)], axis=-1), size)


def pose_of(joint: Joint, parent: Pose, shift: Points) -> Pose:
    """The pose of a part that is shifted."""
    origin = parent.of(np.array(joint.place))
    if joint.kind == "hinge":
        return Pose(shift, origin)
    angle = parent.angle + joint.angle
    return Pose(angle, origin + shift[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def size_of(joint: Joint, shape: tuple[int, int], angles: int = ANGLES) -> tuple[int, int]:
    """Nodes of a joint's chart, for frames of a shape (h, w)."""
    diagonal = int(np.hypot(*shape))
    if joint.kind == "hinge":
        return angles, max(8, round(0.45 * max(shape)))
    return 2 * (diagonal // 2) + 2, 2 * (diagonal // 2)


@dataclass(frozen=True, eq=False)
class Placed:
    """Parts in frames.

    Attributes:
        images: [N, H, W, 3].
        background: [H, W, 3].
        parts: each after its parent.
        fits: of each part.
        poses: of each part.
    """

    images: Array
    background: Array
    parts: tuple[Part, ...]
    fits: tuple[Fit, ...]
    poses: tuple[Pose, ...]

    @classmethod
    def nothing(cls, images: Array, background: Array) -> "Placed":
        """Frames of which only the background is known."""
        return cls(images, background, (), (), ())

    def parent(self, joint: Joint) -> Pose:
        """The pose of what a joint is on."""
        return ground(len(self.images)) if joint.parent is None else self.poses[joint.parent]

    def known(self, without: int | None = None) -> Array:
        """[N, H, W, 3], what is known of the frames, one part left out."""
        drawn = np.repeat(self.background[None], len(self.images), axis=0)
        for k, (part, fit) in enumerate(zip(self.parts, self.fits, strict=True)):
            if k != without:
                drawn = draw(drawn, chart_of(part.joint, self.parent(part.joint), part.size), fit)
        return drawn

    def stack(self, without: int | None = None) -> Array:
        """[N, H, W, 6], frames beside what is known of them."""
        return np.concatenate([self.images, self.known(without)], axis=-1)

    @cached_property
    def unexplained(self) -> Points:
        """[N], squared error of each frame."""
        return ((self.images - self.known()) ** 2).sum(axis=(1, 2, 3)).astype(float)

    def with_part(self, joint: Joint, fit: Fit, size: tuple[int, int]) -> "Placed":
        """One part more."""
        pose = pose_of(joint, self.parent(joint), fit.shift)
        return Placed(
            self.images,
            self.background,
            (*self.parts, Part(joint, fit.shape, size)),
            (*self.fits, fit),
            (*self.poses, pose),
        )

    def replaced(self, k: int, fit: Fit) -> "Placed":
        """Another fit of part k; parts on it move along."""
        parts = list(self.parts)
        parts[k] = Part(parts[k].joint, fit.shape, parts[k].size)
        fits = [*self.fits[:k], fit, *self.fits[k + 1 :]]
        start = Placed.nothing(self.images, self.background)
        for part, each in zip(parts, fits, strict=True):
            start = start.with_part(part.joint, each, part.size)
        return start

    def swept(self, *, learn: bool, sweeps: int = SWEEPS) -> "Placed":
        """Place every part anew while all others are known.

        Args:
            learn: whether its shape is learned anew, too.
            sweeps: times.
        """
        now = self
        for _ in range(sweeps):
            for k, part in enumerate(self.parts):
                chart = chart_of(part.joint, now.parent(part.joint), part.size)
                frames = Alternation(now.stack(without=k), chart)
                now = now.replaced(k, frames.relearn(now.fits[k]) if learn else frames.place(now.parts[k].shape))
        return now


def placed(images: Array, background: Array, parts: Sequence[Part]) -> Placed:
    """Find known parts in frames that their shapes were not learned from."""
    now = Placed.nothing(images, background)
    for part in parts:
        chart = chart_of(part.joint, now.parent(part.joint), part.size)
        fit = Alternation(now.stack(), chart).place(part.shape)
        now = now.with_part(part.joint, fit, part.size)
    return now.swept(learn=False)
