"""The region that a moving part fills, and the point of it that is its keypoint."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from keycld_envs.errors import InputError
from keycld_model.sampling import bilinear, connected, depth, grid, grown
from keycld_model.tracking.alignment import Shape, View, place

Array = NDArray[np.float64]
OFTEN = 0.6
"""Share of frames in which a pixel must differ from the background to belong to the part."""
RIM = 3
"""Working pixels around a part that tell where its edge is."""


def find_shape(
    view: View,
    frames: NDArray[np.intp],
    poses: Array,
    background: Array,
    threshold: float,
    reach: int,
    rods: Array,
    own: int,
) -> Shape:
    """Pixels that move with the part: in its coordinates, they differ from the background in most frames.

    Where there are several rods, only pixels count to which the part's own rod is the nearest in most frames.

    Args:
        view: the frames.
        frames: [n], indices.
        poses: [T, 3], near the true ones.
        background: [h, w] of the picture, in coordinates of the reference.
        threshold: grey levels of a difference.
        reach: half a side of the region that is searched, working pixels.
        rods: [T, K + 1, 2], ends of all rods of the chain, from the pivot on, in the reference picture.
        own: index of the part's rod.

    Raises:
        InputError: if no pixel does.
    """
    points = grid(2 * reach + 1, 2 * reach + 1) - reach
    origin = np.array([view.area[1].start, view.area[0].start], float)
    differs, known, nearest = (np.zeros(points.shape[:2]) for _ in range(3))
    for t in frames:
        where = place(poses[t], points)
        nearest += nearest_rod(where, rods[t]) == own
        away = view(t, where) - bilinear(background, where - origin)
        away -= np.nanmedian(away) if np.isfinite(away).any() else 0
        there = np.isfinite(away)
        known += there
        differs += there & (np.abs(np.where(there, away, 0)) > threshold)
    mask = (differs > OFTEN * known) & (known >= max(3, 0.25 * len(frames))) & (nearest > 0.5 * len(frames))
    labels, number = connected(mask)
    if not number:
        raise InputError(
            f"{view.film.path}: nothing keeps its appearance while it turns about a pivot; film against a plain "
            "background with the camera at rest, or check that the mechanism is the one in the video."
        )
    sizes = ndimage.sum_labels(mask, labels, np.arange(1, number + 1))
    mask = labels == 1 + int(np.argmax(sizes))
    rows, columns = np.nonzero(grown(mask, RIM + 1))
    cut = slice(max(0, rows.min()), rows.max() + 1), slice(max(0, columns.min()), columns.max() + 1)
    mask = mask[cut]
    return Shape(points[cut], mask, grown(mask, RIM))


def nearest_rod(points: Array, ends: Array) -> NDArray[np.intp]:
    """Index of the rod that is nearest to each point.

    Args:
        points: [..., 2].
        ends: [K + 1, 2], of the K rods of a chain.
    """
    distances = []
    for start, end in pairwise(ends):
        along = end - start
        share = np.clip((points - start) @ along / max(float(along @ along), 1e-9), 0, 1)
        distances.append(np.linalg.norm(points - start - share[..., None] * along, axis=-1))
    return np.argmin(distances, axis=0)


def thickest(shape: Shape, away_from: Array | None = None) -> tuple[Array, float]:
    """The centre of the thickest part of a shape, and the radius of the disc that fits into it.

    Args:
        shape: of a part.
        away_from: [2] a point of the part, such as its pivot; of equally thick places, the one farthest from it counts.

    Returns:
        [2] and working pixels.
    """
    deep = depth(shape.mask)
    radius = float(deep.max())
    core = deep >= 0.6 * radius
    labels, number = connected(core)
    middle = np.array([shape.grid[labels == n].mean(axis=0) for n in range(1, number + 1)])
    if away_from is None:
        deepest = [deep[labels == n].max() for n in range(1, number + 1)]
        best = 1 + int(np.argmax(deepest))
    else:
        thick = np.array([deep[labels == n].max() >= 0.9 * radius for n in range(1, number + 1)])
        best = 1 + int(np.argmax(np.where(thick, np.linalg.norm(middle - away_from, axis=1), -1)))
    around = shape.mask & grown(labels == best, max(1, round(0.6 * radius)))
    return shape.grid[around].mean(axis=0), radius
