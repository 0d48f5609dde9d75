"""Where something moves, before anything is known about it: blobs that differ from the background."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from keycld_envs.progress import Advance
from keycld_model.sampling import bilinear, connected, grid
from keycld_model.tracking.camera import Camera
from keycld_model.tracking.film import Film

Array = NDArray[np.float64]
CONTRAST = 5.0
"""Noise levels by which a moving thing differs from the background."""
SMALLEST = 12
"""Working pixels of the smallest blob."""
MOST = 6
"""Blobs of a frame that are looked at, the strongest."""
SIDE, FRAMES = 320, 400
"""Pixels of the longer side, and frames, in which blobs are sought; what they are for is a first guess."""
CELL = 4.0
"""Working pixels of a place."""
CIRCLES = 4000
"""Triples of blobs that are tried for a circle."""


@dataclass(frozen=True, eq=False)
class Blobs:
    """The strongest blobs of each frame, in coordinates of the reference picture.

    Attributes:
        centres: [T, n, 2], working pixels, NaN where there are fewer.
        energy: [T, n], sum of contrast, grey levels.
        noise: grey levels by which the background scatters about its median.
    """

    centres: Array
    energy: Array
    noise: float


def find_blobs(film: Film, camera: Camera, background: Array, area: tuple[slice, slice], advance: Advance) -> Blobs:
    """Threshold the difference from the background, frame by frame.

    Args:
        film: the video.
        camera: its motion.
        background: [h, w] of the area, in coordinates of the reference picture.
        area: rows and columns of the picture.
        advance: a progress bar, one step per frame.
    """
    rows, columns = area
    points = grid(*background.shape) + np.array([columns.start, rows.start], float)
    noise = background_noise(film, camera, background, points)
    centres = np.full((len(film), MOST, 2), np.nan)
    energy = np.zeros((len(film), MOST))
    step = max(1, round(max(background.shape) / SIDE))
    blurred = ndimage.gaussian_filter(background, 0.5 * step)[::step, ::step]
    coarse = points[::step, ::step]
    for t in range(0, len(film), max(1, len(film) // FRAMES)):
        away = difference(film, camera, blurred, coarse, t, 0.5 * step)
        labels, number = connected(away > CONTRAST * noise)
        if number:
            index = np.arange(1, number + 1)
            size = ndimage.sum_labels(np.ones_like(away), labels, index)
            strength = np.where(size >= SMALLEST / step**2, ndimage.sum_labels(away, labels, index), 0)
            best = index[np.argsort(-strength)[:MOST]]
            best = best[strength[best - 1] > 0]
            for n, (row, column) in enumerate(ndimage.center_of_mass(away, labels, best)):
                centres[t, n] = step * column + columns.start, step * row + rows.start
                energy[t, n] = strength[best[n] - 1]
        advance()
    return Blobs(centres, energy, noise)


def difference(film: Film, camera: Camera, background: Array, points: Array, t: int, blur: float = 0.0) -> Array:
    """How far each pixel of frame t is from the background, grey levels, [h, w]; 0 where the frame does not reach."""
    pixels = ndimage.gaussian_filter(film.pixels[t].astype(np.float32), blur) if blur else film.pixels[t]
    values = bilinear(pixels, camera.to_frame(t, points) if camera.moves else points)
    away = values - background
    light = np.nanmedian(away[::4, ::4])
    return np.nan_to_num(np.abs(away - light))


def background_noise(film: Film, camera: Camera, background: Array, points: Array) -> float:
    """Robust scatter of frames about the background."""
    some = range(0, len(film), max(1, len(film) // 16))
    return float(np.median([1.4826 * np.median(difference(film, camera, background, points, t)) for t in some])) + 0.3


def find_circle(
    blobs: Blobs, shape: tuple[int, int], rng: np.random.Generator
) -> tuple[Array, float, NDArray[np.intp]] | None:
    """The circle on which most energy moves, by random triples of blobs of different frames.

    Args:
        blobs: of each frame.
        shape: (h, w) of the picture; a circle is at least 2 % and at most three times its longer side.
        rng: draws the triples.

    Returns:
        Centre [2], radius, and the blob of each frame that lies on it, [T], -1 for none; None if nothing turns.
    """
    t, n = np.nonzero(blobs.energy > 0)
    if len(np.unique(t)) < 6:
        return None
    places, weight = blobs.centres[t, n], blobs.energy[t, n]
    cells, counts = np.unique(np.rint(places / CELL), axis=0, return_inverse=True, return_counts=True)[1:]
    weight = weight / counts[cells.ravel()]  # a place where something rests counts once
    chance = weight / weight.sum()
    triples = places[rng.choice(len(t), (CIRCLES, 3), p=chance)]
    centres, radii = _circles(triples)
    side = max(shape)
    good = np.isfinite(radii) & (radii > 0.02 * side) & (radii < 3 * side)
    best, chosen = 0.0, None
    some = np.argsort(-weight)[:1500]
    for centre, radius in zip(centres[good], radii[good], strict=True):
        off = np.abs(np.linalg.norm(places[some] - centre, axis=1) - radius)
        width = 0.02 * min(radius, 0.3 * side) + 1
        score = float((weight[some] * np.clip(1 - (off / width) ** 2, 0, None)).sum())
        if score > best:
            angles = np.arctan2(*(places[some][off < width] - centre).T)
            if np.ptp(np.unwrap(np.sort(angles))) * radius > 0.03 * side:
                best, chosen = score, (centre, radius, width)
    if chosen is None:
        return None
    centre, radius, width = chosen
    off = np.abs(np.linalg.norm(blobs.centres - centre, axis=2) - radius)
    score = np.where(off < 2 * width, blobs.energy, 0)
    member = np.where(score.max(axis=1) > 0, score.argmax(axis=1), -1)
    return centre, radius, member


def _circles(triples: Array) -> tuple[Array, Array]:
    """Centres and radii of the circles through triples of points [N, 3, 2]; NaN for points in line."""
    a, b, c = triples[:, 0], triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        d = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
        bb, cc = (b**2).sum(axis=1), (c**2).sum(axis=1)
        offset = np.stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb], axis=1) / d[:, None]
        return a + offset, np.linalg.norm(offset, axis=1)
