"""The shape of a moving part, and how far it is shifted in each frame: both at once, by alternation."""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from keycld_model.discovery.charts import Array, Chart, Points, sample

ROUNDS = 4
"""Alternations between shifts and shape."""
CONTRAST = 0.1
"""Of the strongest difference from what is known; what differs less in a frame is not part of the first guess."""
OUTLIER = 0.1
"""Difference of colour (0 to 1) beyond which a pixel counts less: another part covers it."""
FEWEST = 3
"""Frames that must show a part."""
FAINT = 0.01
"""Difference of colour (0 to 1), root mean square, that a place of a part must explain: two or three grey levels. On a
background of one colour, all places that show it explain as much, which is nothing but rounding."""
SEEN = 0.3
"""Share of frames that must show a place of a part."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A part on the grid of its chart.

    Attributes:
        there: [S, W], 1 where the part is, 0 elsewhere.
        colour: [S, W, 3], 0 to 1.
    """

    there: Array
    colour: Array


@dataclass(frozen=True, eq=False)
class Fit:
    """A part and where it is.

    Attributes:
        shape: of the part.
        shift: [N], rad or pixels.
        gain: [N], by how much it reduces each frame's squared error; 0 where it is not seen.
    """

    shape: Shape
    shift: Points
    gain: Points

    @property
    def total(self) -> float:
        """The reduction over all frames."""
        return float(self.gain.sum())


class Alternation:
    """Frames on one chart; shapes are fitted to them.

    Scores of all shifts, and sums over frames that are shifted back, are products in the Fourier domain.
    """

    def __init__(self, stack: Array, chart: Chart) -> None:
        """Sample frames and what is known of them: the background and parts found before, [N, H, W, 6]."""
        points, area = chart.nodes()
        values, inside = sample(stack, points)
        weight = inside * area
        self.chart, self.area, self.values = chart, area, values[..., :3]
        self.error = ((self.values - values[..., 3:]) ** 2).sum(axis=-1) * weight
        self.data = np.empty((*self.error.shape, 5), np.float32)
        self.data[..., 0] = self.error - weight * (self.values**2).sum(axis=-1)
        self.data[..., 1:4] = self.values * weight[..., None]
        self.data[..., 4] = weight
        spectrum = np.fft.rfft(self.data, axis=1).transpose(1, 0, 2, 3)
        self.spectrum = np.ascontiguousarray(spectrum).reshape(*spectrum.shape[:2], -1)

    def fit(self, starts: list[int], rounds: int = ROUNDS) -> Fit:
        """The best of alternations that start from what differs from the known in single frames."""
        tries = []
        for start in starts:
            raw = self.error[start] / self.area
            shape = Shape((raw > CONTRAST * raw.max()).astype(np.float32), self.values[start])
            tries.append(self.refine(shape, rounds))
        best = max(tries, key=lambda fit: fit.total)
        return best if self.chart.circular else self.place(_centred(best.shape))

    def relearn(self, fit: Fit) -> Fit:
        """The shape anew where the part is, then its place; what covers it in some frames does not colour it."""
        index = np.rint(fit.shift / self.chart.unit).astype(int) % self.chart.size[0]
        shape = self._average(index, fit.gain > 0, robust=True)
        return self.place(shape if shape.there.any() else fit.shape)

    def refine(self, shape: Shape, rounds: int = ROUNDS) -> Fit:
        """Alternate from a shape."""
        for _ in range(rounds):
            scores = self._scores(shape)
            index = scores.argmax(axis=1)
            seen = scores.max(axis=1) > 0
            if seen.sum() < FEWEST:
                break
            new = self._average(index, seen)
            if not new.there.any():
                break
            shape = new
        return self.place(shape)

    def place(self, shape: Shape) -> Fit:
        """Where a shape is in each frame."""
        scores = self._scores(shape)
        index = scores.argmax(axis=1)
        rows, size = np.arange(len(scores)), scores.shape[1]
        low, top, high = (scores[rows, (index + d) % size] for d in (-1, 0, 1))
        bend = low - 2 * top + high
        part = np.where(bend < 0, 0.5 * (low - high) / np.where(bend < 0, bend, 1), 0.0).clip(-0.5, 0.5)
        signed = (index + part + size / 2) % size - size / 2
        return Fit(shape, signed * self.chart.unit, np.maximum(top, 0).astype(np.float64))

    def _scores(self, shape: Shape) -> Array:
        """[N, S], reduction of the squared error for every shift."""
        there = shape.there[..., None]
        square = (shape.colour**2).sum(axis=-1, keepdims=True)
        pattern = np.concatenate([there, 2 * there * shape.colour, -there * square], axis=-1)
        spectrum = np.fft.rfft(pattern.astype(np.float32), axis=0).conj()
        product = np.matmul(self.spectrum, spectrum.reshape(len(spectrum), -1, 1))[..., 0]
        return np.fft.irfft(product, n=len(pattern), axis=0).T

    def _average(self, index: NDArray[np.intp], seen: NDArray[np.bool_], *, robust: bool = False) -> Shape:
        """The shape that reduces the error most, when frames are shifted back."""
        size = self.chart.size[0]
        wave = np.exp(2j * np.pi / size * np.arange(len(self.spectrum))[:, None] * index) * seen
        product = np.matmul(wave[:, None].astype(np.complex64), self.spectrum)
        sums = np.fft.irfft(product.reshape(len(product), *self.area.shape[1:], 5), n=size, axis=0)
        total = np.maximum(sums[..., 4], 1e-3 * self.area)
        colour = sums[..., 1:4] / total[..., None]
        if robust:
            colour = self._robust(colour, index, seen)
        gain = sums[..., 0] + 2 * (sums[..., 1:4] * colour).sum(axis=-1) - total * (colour**2).sum(axis=-1)
        mode = ("wrap" if self.chart.circular else "nearest", "nearest")
        smooth = ndimage.uniform_filter(gain, 3, mode=cast(str, mode))
        there = (smooth > FAINT**2 * total) & (total > SEEN * self.area * seen.sum())
        return Shape(there.astype(np.float32), colour.astype(np.float32))

    def _robust(self, colour: Array, index: NDArray[np.intp], seen: NDArray[np.bool_]) -> Array:
        """The mean colour anew, with less weight where a frame differs."""
        rows = (np.arange(self.chart.size[0]) + index[:, None]) % self.chart.size[0]
        aligned = np.take_along_axis(self.data[seen], rows[seen][:, :, None, None], axis=1)
        values = aligned[..., 1:4] / np.maximum(aligned[..., 4:], 1e-6)
        weight = aligned[..., 4] / (1 + ((values - colour) ** 2).sum(axis=-1) / OUTLIER**2)
        return (values * weight[..., None]).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-6)[..., None]


def resampled(shape: Shape, old: Chart, new: Chart, reduction: float) -> Shape:
    """A shape on the grid of another chart of the same joint, whose pixels are smaller by `reduction`."""
    index = np.rint(old.own.coordinates(new.offsets() / reduction, np.zeros(1))[:, 0]).astype(int)
    if old.circular:
        index[0] %= old.size[0]
    inside = ((index >= 0) & (index < np.array(old.size)[:, None, None])).all(axis=0)
    rows, columns = index.clip(0, np.array(old.size)[:, None, None] - 1)
    return Shape(shape.there[rows, columns] * inside, shape.colour[rows, columns])


def _centred(shape: Shape) -> Shape:
    """The shape moved along its rail to the middle, so that its shift is where it is."""
    size, turn = len(shape.there), np.exp(2j * np.pi * np.arange(len(shape.there)) / len(shape.there))
    middle = np.angle((shape.there.sum(axis=1) * turn).sum()) / (2 * np.pi) * size
    by = size // 2 - round(float(middle))
    return Shape(np.roll(shape.there, by, axis=0), np.roll(shape.colour, by, axis=0))


def draw(known: Array, chart: Chart, fit: Fit) -> Array:
    """Frames [N, H, W, 3] with a part drawn over what is known, where it is seen."""
    height, width = known.shape[1:3]
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
    where = chart.coordinates(pixels, fit.shift)
    there = _look_up(fit.shape.there, where, chart.circular)
    painted = [_look_up(fit.shape.there * fit.shape.colour[..., c], where, chart.circular) for c in range(3)]
    seen = (fit.gain > 0).astype(np.float32)[:, None, None, None]
    return known + seen * (np.stack(painted, axis=-1) - there[..., None] * known)


def _look_up(grid: Array, where: Points, circular: bool) -> Array:
    """Values of a grid [S, W] at indices [2, ...], linearly; 0 outside."""
    if circular:
        grid = np.concatenate([grid, grid[:1]])
        where = np.stack([where[0], where[1].clip(0)])
    return cast(Array, ndimage.map_coordinates(grid, where, order=1, mode="constant", output=np.float32))
