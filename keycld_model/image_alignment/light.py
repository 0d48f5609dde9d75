"""How bright a camera shows what a renderer draws: a factor and an offset of each colour."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]
DIMMEST = 0.05
"""A camera shows contrasts at least this much of what is drawn; below, a colour tells nothing."""
WHITE = 255.0
"""Grey levels."""
PIXELS = 5_000
"""More pixels tell no more."""


@dataclass(frozen=True)
class Light:
    """Of one recording: shown = gain * drawn + offset.

    Attributes:
        gain: `[3]` of red, green and blue.
        offset: `[3]` grey levels, 0 to 255.
    """

    gain: Array
    offset: Array

    @classmethod
    def unchanged(cls) -> "Light":
        """The renderer's own."""
        return cls(np.ones(3), np.zeros(3))

    @classmethod
    def of(cls, drawn: Image, shown: Image, rounds: int = 6) -> "Light":
        """Robust regression of what is shown on what is drawn, both `[..., H, W, 3]`.

        Clipped pixels, and what is drawn elsewhere than it is shown, weigh little. A colour that is the same all over
        the image keeps its gain.
        """
        gain, offset = np.ones(3), np.zeros(3)
        for c in range(3):
            x, y = (np.asarray(image[..., c], np.float64).ravel() for image in (drawn, shown))
            there = (y > 2) & (y < 253)
            if there.sum() < 0.05 * len(y):
                continue
            every = max(1, int(there.sum()) // PIXELS)
            x, y = x[there][::every], y[there][::every]
            weight = np.ones(len(x))
            for _ in range(rounds):
                total = weight.sum()
                mx, my = weight @ x / total, weight @ y / total
                spread = weight @ (x - mx) ** 2
                if spread > total:  # of a grey level or more
                    gain[c] = max(DIMMEST, weight @ ((x - mx) * (y - my)) / spread)
                offset[c] = my - gain[c] * mx
                left = y - gain[c] * x - offset[c]
                scale = max(1.0, 1.4826 * float(np.median(np.abs(left))))
                weight = (1 + (left / (3 * scale)) ** 2) ** -2
        return cls(gain, offset)

    def apply(self, drawn: Image) -> Image:
        """What the camera shows of a drawn image `[..., 3]`, from black to white."""
        return np.clip(drawn * self.gain + self.offset, 0.0, WHITE).astype(np.float32)
