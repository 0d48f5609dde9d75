"""How a camera shows a scene otherwise than a model draws it, told from the background, and images brought back.

A camera that has moved by a few pixels, or another light, changes all of an image; the mechanism is a small part of it.
So one image tells how the camera differs, by comparison with the background that the model has learned: no labels, no
training. Images are then brought to the model's camera and light.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_model.modules import as_float

Floats = NDArray[np.float64]
GREY = 1 / 255
"""One grey level."""
ALIKE = 1.0 * GREY
"""An image whose pixels differ less from the background, in the median, comes from the model's own camera."""
FARTHEST = 4
"""Pixels by which a camera may be off, in either direction."""
EXPECTED = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""Shift (pixels), the zoom's logarithm, gains and offsets (0 to 1) of the model's own camera."""
SPREAD = np.array([4.0, 4.0, 0.03, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
"""Standard deviations expected of them, which count where a background shows nothing."""
DARKEST, BRIGHTEST = 0.4, 2.5
"""Range of the light's factor."""
STEPS = 9
"""Gauss-Newton steps."""
FAINT = 6 * GREY
"""Differences below this are no mechanism's."""
NOISIEST = 40.0
"""Grey levels of what may be left, as standard deviation."""
NOISY = 2.0
"""Differences from the background are kept as far as their local mean square exceeds so many variances of the noise."""


class Restoration(NamedTuple):
    """What brings images to the model's camera, as arrays.

    Attributes:
        changed: whether there is anything to change (bool).
        rows: `[H, H]` resamples columns of pixels; zero where the camera shows nothing.
        columns: `[W, W]` the same for rows of pixels.
        gain: `[3]` of the light.
        offset: `[3]` of the light, 0 to 1.
        ceiling: `[3]` what stands where a colour is cut off, 0 to 1.
        noise: standard deviation of a pixel after restoration, 0 to 1.
    """

    changed: NDArray[np.bool_]
    rows: NDArray[np.float32]
    columns: NDArray[np.float32]
    gain: NDArray[np.float32]
    offset: NDArray[np.float32]
    ceiling: NDArray[np.float32]
    noise: NDArray[np.float32]


@dataclass(frozen=True)
class Camera:
    """How a camera differs from the model's: shown = gain * drawn + offset, moved and magnified.

    Attributes:
        right: image content is shifted to the right, pixels.
        up: and upwards, pixels.
        zoom: factor of lengths.
        gain: of red, green and blue.
        offset: of red, green and blue, grey levels, 0 to 255.
        noise: standard deviation of what is left, grey levels.
    """

    right: float = 0.0
    up: float = 0.0
    zoom: float = 1.0
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: float = 0.0

    @classmethod
    def find(
        cls, background: NDArray[np.float32], image: NDArray[np.uint8] | NDArray[np.float32], alike: float = ALIKE
    ) -> "Camera | None":
        """Find it from one image.

        Args:
            background: `[H, W, 3]` what the model draws without the mechanism, 0 to 1.
            image: `[H, W, 3]` what the camera shows, uint8 or float in 0 to 1.
            alike: median difference, 0 to 1, up to which it is the model's own camera.

        Returns:
            The camera; None if the image does not show the background, or in too different a way.
        """
        drawn = np.asarray(background, np.float64)
        shown = np.asarray(as_float(jnp.asarray(image)), np.float64)
        if not (np.isfinite(drawn).all() and np.isfinite(shown).all()):
            return None
        if np.median(np.abs(shown - drawn)) <= alike:
            return cls()
        values, noise = _fit(drawn, shown)
        right, up, zoom = float(values[0]), float(values[1]), float(np.exp(values[2]))
        gain, offset = values[3:6], values[6:]
        near = max(abs(right), abs(up)) <= FARTHEST and noise <= NOISIEST * GREY
        if not (near and DARKEST < gain.min() <= gain.max() < BRIGHTEST):  # also for NaN
            return None
        return cls(right, up, zoom, tuple(gain.tolist()), tuple((offset / GREY).tolist()), noise / GREY)

    def restoration(self, drawn: NDArray[np.float32]) -> Restoration:
        """For images like those that the model draws, `[N, H, W, 3]`, 0 to 1.

        Where a colour is cut off at 255, the mean of all that is drawn as bright as that stands for it.
        """
        height, width = drawn.shape[1:3]
        rows = resampling(height, -self.up, self.zoom)
        columns = resampling(width, self.right, self.zoom)
        gain, offset = np.asarray(self.gain, np.float32), np.asarray(self.offset, np.float32) * np.float32(GREY)
        cut = (1 - offset) / gain
        bright = drawn > cut
        ceiling = np.where(bright, drawn, 0).sum((0, 1, 2)) / np.maximum(bright.sum((0, 1, 2)), 1)
        return Restoration(
            np.array(self != Camera()),
            rows.astype(np.float32),
            columns.astype(np.float32),
            gain,
            offset,
            np.maximum(ceiling, cut).astype(np.float32),
            np.array(self.noise * GREY / gain.mean(), np.float32),
        )


def restore(restoration: Restoration, background: Array, image: Array) -> Array:
    """An image `[H, W, 3]` as the model's camera would have shown it, 0 to 1; bit by bit if that is the camera.

    Where the camera shows nothing, and where noise is all there is, stands the background `[H, W, 3]`. JAX-traceable.
    """

    def changed(pixels: Array) -> Array:
        lit = (pixels - restoration.offset) / restoration.gain
        lit = jnp.where(pixels > 1 - GREY / 2, restoration.ceiling, lit)
        moved = jnp.einsum("ij,jkc,lk->ilc", restoration.rows, lit, restoration.columns)
        seen = jnp.sum(restoration.rows, 1)[:, None, None] * jnp.sum(restoration.columns, 1)[:, None]
        differs = moved - seen * background
        energy = _blurred(jnp.mean(differs**2, axis=-1))
        kept = jnp.maximum(0.0, 1 - NOISY * restoration.noise**2 / jnp.maximum(energy, 1e-12))
        return background + kept[..., None] * differs

    return jax.lax.cond(restoration.changed, changed, lambda pixels: pixels, as_float(jnp.asarray(image)))


def restored(restoration: Restoration, background: NDArray[np.float32], image: NDArray[Any]) -> NDArray[Any]:
    """The same outside of JAX's programs; the image itself if there is nothing to change."""
    if not restoration.changed:
        return image
    out = restore(restoration, jnp.asarray(background), jnp.asarray(image))
    return np.clip(np.asarray(out), 0.0, 1.0)


def resampling(size: int, shift: float, zoom: float) -> Floats:
    """Matrix `[size, size]` whose row i reads pixels at c + zoom (i - c) + shift, c the centre, by cubic convolution.

    Rows that would read beyond the last pixels are zero.
    """
    centre = (size - 1) / 2
    where = centre + zoom * (np.arange(size) - centre) + shift
    first = np.floor(where).astype(int)
    out = np.zeros((size, size))
    for tap in (-1, 0, 1, 2):
        distance = np.abs(where - first - tap)
        weight = np.where(
            distance < 1,
            1.5 * distance**3 - 2.5 * distance**2 + 1,
            -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2,
        )
        np.add.at(out, (np.arange(size), np.clip(first + tap, 0, size - 1)), weight)
    out[(where < -1e-6) | (where > size - 1 + 1e-6)] = 0.0
    return out


def _blurred(x: Array) -> Array:
    """Mean over 3 x 3 pixels, `[H, W]`."""
    padded = jnp.pad(x, 1, mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9


def _coarse(drawn: Floats, shown: Floats) -> tuple[int, int]:
    """Shift in whole pixels, to the right and up, in the light that suits it best."""
    height, width = drawn.shape[:2]
    n = min(FARTHEST, height // 4, width // 4)
    still = drawn[n : height - n : 2, n : width - n : 2]
    x = still - still.mean((0, 1))
    spread = (x**2).sum((0, 1)) + 1e-9

    def misfit(shift: tuple[int, int]) -> float:
        right, up = shift
        part = shown[n - up : height - n - up : 2, n + right : width - n + right : 2]
        y = part - part.mean((0, 1))
        return float(np.abs(y - (x * y).sum((0, 1)) / spread * x).mean())

    return min(((r, u) for r in range(-n, n + 1) for u in range(-n, n + 1)), key=misfit)


def _fit(drawn: Floats, shown: Floats) -> tuple[Floats, float]:
    """Robust Gauss-Newton, first on the light, then on place and light together.

    Returns:
        `[9]` right and up (pixels), the zoom's logarithm, gains, offsets (0 to 1); standard deviation of what is left.
    """
    values, precision = EXPECTED.copy(), SPREAD**-2.0
    values[:2] = _coarse(*(gaussian_filter(image, (1, 1, 0)) for image in (drawn, shown)))
    inside = (shown > 2 * GREY) & (shown < 1 - 2 * GREY)  # the others are cut off
    for step in range(STEPS):
        free = slice(3 if step < STEPS // 2 else 0, None)
        left, scale, weight = _left(drawn, shown, inside, values)
        slopes = _slopes(drawn, values).reshape(-1, 9)
        weights = weight.reshape(-1, 1) / scale**2
        normal = slopes.T @ (weights * slopes) + np.diag(precision)
        gradient = slopes.T @ (weights[:, 0] * left.ravel()) + precision * (EXPECTED - values)
        change = np.zeros(9)
        change[free] = np.linalg.solve(normal[free, free], gradient[free])
        values = values + change * min(1.0, 1 / float(np.abs(change[:2]).max() + 1e-9))
    return values, _left(drawn, shown, inside, values)[1]


def _left(drawn: Floats, shown: Floats, inside: NDArray[np.bool_], values: Floats) -> tuple[Floats, float, Floats]:
    """What values do not explain, `[H, W, 3]`, its robust standard deviation, and how much each pixel counts."""
    here, there = _moved(drawn, values)
    left, valid = shown - values[3:6] * here - values[6:], inside & there
    scale = _deviation(left[valid])
    off = np.mean(left**2, axis=-1, keepdims=True) / max(3 * scale, FAINT) ** 2
    return left, scale, valid * (1 + off) ** -2.0


def _deviation(left: Floats) -> float:
    """Robust standard deviation, half a grey level at least."""
    return max(GREY / 2, 1.4826 * float(np.median(np.abs(left)))) if left.size else 1.0


def _slopes(drawn: Floats, values: Floats) -> Floats:
    """Derivatives `[H, W, 3, 9]` of what is shown, in a light and at a place, to all values."""
    height, width = drawn.shape[:2]
    here, _ = _moved(drawn, values)
    factor = values[3:6] / np.exp(values[2])
    down, right = (_moved(np.asarray(slope), values)[0] * factor for slope in np.gradient(drawn, axis=(0, 1)))
    row = (np.arange(height) - (height - 1) / 2 + values[1])[:, None, None]
    column = (np.arange(width) - (width - 1) / 2 - values[0])[None, :, None]
    out = np.zeros((*here.shape, 9))
    out[..., 0], out[..., 1], out[..., 2] = -right, down, -(column * right + row * down)
    for c in range(3):
        out[:, :, c, 3 + c], out[:, :, c, 6 + c] = here[..., c], 1.0
    return out


def _moved(drawn: Floats, values: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """What is drawn, as a camera that is so placed shows it, and where there is anything drawn, `[H, W, 1]`."""
    height, width, colours = drawn.shape
    zoom = float(np.exp(-values[2]))
    rows, columns = resampling(height, zoom * values[1], zoom), resampling(width, -zoom * values[0], zoom)
    there = (rows.sum(1)[:, None, None] * columns.sum(1)[:, None]) > 0.5
    tall = (rows @ drawn.reshape(height, -1)).reshape(height, width, colours)
    return np.matmul(columns, tall), there
