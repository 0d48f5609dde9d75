"""Coordinates in which a joint's motion is a shift: angle and radius about a hinge, along and across a rail."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Chart:
    """A grid for each frame, along whose first axis a part of one joint is shifted from frame to frame.

    Attributes:
        origin: [N, 2], the hinge, or zero of the rail, pixels (x right, y down).
        along: [N, 2], unit vector of the rail; None for a hinge.
        size: nodes along the first axis (angle, or along the rail) and the second (radius, or across).
    """

    origin: Points
    along: Points | None
    size: tuple[int, int]

    @property
    def circular(self) -> bool:
        """Whether the first axis is an angle."""
        return self.along is None

    @property
    def unit(self) -> float:
        """Of a shift by one node, rad or pixels."""
        return 2 * np.pi / self.size[0] if self.along is None else 1.0

    def nodes(self) -> tuple[Points, Array]:
        """Places [N, S, W, 2] of nodes, pixels, and the area [S, W] that each stands for, square pixels."""
        first, second = np.arange(self.size[0]), np.arange(self.size[1])
        if self.along is None:
            angle, radius = first * self.unit, second + 0.5
            offset = radius[None, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
            area = np.broadcast_to(radius * self.unit, self.size)
            return self.origin[:, None, None] + offset, area.astype(np.float32)
        across = np.stack([-self.along[:, 1], self.along[:, 0]], axis=-1)
        offset = (first - self.size[0] // 2)[:, None, None] * self.along[:, None, None]
        offset = offset + (second - self.size[1] // 2)[:, None] * across[:, None, None]
        return self.origin[:, None, None] + offset, np.ones(self.size, np.float32)

    def coordinates(self, points: Points, shift: Points) -> Points:
        """Indices [2, N, ...] into a part's grid, of points [..., 2] in every frame when it is shifted.

        Args:
            points: pixels.
            shift: [N], rad or pixels.
        """
        away = points[None] - self.origin.reshape(-1, *(1,) * (points.ndim - 1), 2)
        by = shift.reshape(-1, *(1,) * (points.ndim - 1))
        if self.along is None:
            angle = np.arctan2(away[..., 1], away[..., 0]) - by
            return np.stack([angle / self.unit % self.size[0], np.hypot(away[..., 0], away[..., 1]) - 0.5])
        along = self.along.reshape(-1, *(1,) * (points.ndim - 1), 2)
        first = (away * along).sum(axis=-1) - by
        second = away[..., 1] * along[..., 0] - away[..., 0] * along[..., 1]
        return np.stack([first + self.size[0] // 2, second + self.size[1] // 2])

    @property
    def own(self) -> "Chart":
        """The same grid in the frame of its part, at shift zero."""
        return own_chart(self.size, circular=self.circular)

    def offsets(self) -> Points:
        """[S, W, 2], places of a part's nodes in its own frame, pixels from its origin."""
        return self.own.nodes()[0][0]


def own_chart(size: tuple[int, int], *, circular: bool) -> Chart:
    """The grid of a part in its own frame: about its hinge, or along its rail, at shift zero."""
    return Chart(np.zeros((1, 2)), None if circular else np.array([[1.0, 0.0]]), size)


def sample(images: Array, points: Points) -> tuple[Array, NDArray[np.bool_]]:
    """Values [N, ..., C] of images [N, H, W, C] at points [N, ..., 2], linearly, and whether they are inside."""
    number, height, width, channels = images.shape
    corner = np.floor(points).astype(np.int32)
    inside = cast(NDArray[np.bool_], ((corner >= 0) & (corner < (width - 1, height - 1))).all(axis=-1))
    corner = corner.clip(0, (width - 2, height - 2))
    part = (points - corner).astype(np.float32)
    x, y = part[..., :1], part[..., 1:]
    flat = images.reshape(-1, channels)
    base = np.arange(number, dtype=np.int32).reshape(-1, *(1,) * (points.ndim - 2)) * (height * width)
    base = base + corner[..., 1] * width + corner[..., 0]
    top = flat[base] * (1 - x) + flat[base + 1] * x
    low = flat[base + width] * (1 - x) + flat[base + width + 1] * x
    return top * (1 - y) + low * y, inside
