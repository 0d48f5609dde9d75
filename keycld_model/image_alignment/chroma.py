"""Colours of compressed films, of which every second pixel is kept at most.

JPEG and most video codecs keep brightness (luma) for every pixel, and colour (chroma) for squares of 2 × 2 pixels
("4:2:0"), so that coloured edges are not where they were.
"""

from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Frames = NDArray[np.uint8]
Upsampling = Literal["linear", "nearest"]
"""How a decoder fills the squares: JPEG's between neighbours, some of videos with one colour each."""
TO_LUMA_AND_CHROMA = np.array(
    [[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]], np.float32
)
"""Of red, green and blue: ITU-T T.871, section 7."""
NEUTRAL = 128.0
"""Value that grey has as a chroma."""
WEIGHT = 0.25
"""Of chroma beside luma in a film whose chroma was halved. Compression takes more from chroma, and leaves it off
from place to place; where parts of a scene differ in colour alone, it still tells positions."""
SUBSAMPLED = 0.07
"""Share of the detail of luma, mean square of what halving takes away, that whole chroma has more of. In 43 films of
three mechanisms the least whole chroma had .15, the most of JPEG's .03."""
LOOKED_AT = 12
"""Frames of a recording that are looked at."""


class HalvedChroma:
    """What films and drawings become to be compared: luma, and chroma as far as the film has it.

    Attributes:
        upsampling: of the decoder.
    """

    def __init__(self, upsampling: Upsampling, size: tuple[int, int]) -> None:
        """For images of a size (H, W)."""
        self.upsampling = upsampling
        self._rows, self._columns = (np.float32(_up(n, upsampling) @ _halving(n)) for n in size)

    @classmethod
    def of(cls, films: Sequence[Frames]) -> Self | None:
        """As films `[T, H, W, 3]` of one size show it; None if their chroma is whole."""
        size = films[0].shape[1:3]
        if min(size) < 4:
            return None
        some = [luma_and_chroma(frame) for film in films for frame in film[:: max(1, len(film) // LOOKED_AT)]]
        left: dict[Upsampling, Array] = {kind: _left(some, kind) for kind in ("linear", "nearest")}
        kind = min(left, key=lambda one: float(np.sum(left[one][1:])))
        luma, blue, red = left[kind]
        return cls(kind, size) if blue + red < SUBSAMPLED * luma else None

    def filmed(self, frames: Frames) -> Frames:
        """A film `[T, H, W, 3]` of red, green and blue as luma and chroma of less weight, 0 to 255."""
        return np.stack(
            [np.clip(np.round(_weighed(luma_and_chroma(frame))), 0, 255).astype(np.uint8) for frame in frames]
        )

    def drawn(self, image: Image) -> Image:
        """A drawing `[H, W, 3]` of red, green and blue likewise, its chroma halved as the film's was."""
        out = luma_and_chroma(image)
        for c in (1, 2):
            out[..., c] = self._rows @ out[..., c] @ self._columns.T
        return _weighed(out)


def luma_and_chroma(image: Image | Frames) -> Image:
    """Luma, blue and red difference of an image `[..., 3]`, with chroma about 0."""
    return np.asarray(image, np.float32) @ TO_LUMA_AND_CHROMA.T


def _weighed(image: Image) -> Image:
    """With less weight of chroma, about `NEUTRAL`."""
    return image * np.array([1, WEIGHT, WEIGHT], np.float32) + np.array([0, NEUTRAL, NEUTRAL], np.float32)


def _left(images: Sequence[Image], upsampling: Upsampling) -> Array:
    """Mean squares `[3]` of what no halved channel of images `[H, W, 3]` can show."""
    rows, columns = (up @ np.linalg.pinv(up) for up in (_up(n, upsampling) for n in images[0].shape[:2]))
    channels = np.moveaxis(np.stack(images), -1, 0)  # [3, N, H, W]
    return np.mean((channels - rows @ channels @ columns) ** 2, axis=(1, 2, 3))


def _halving(size: int) -> Array:
    """Means of pairs of neighbours `[half, size]`; an odd last one is its own."""
    out = np.zeros(((size + 1) // 2, size))
    out[np.arange(size) // 2, np.arange(size)] = 1
    return out / out.sum(axis=1, keepdims=True)


def _up(size: int, upsampling: Upsampling) -> Array:
    """Halved pixels to whole ones `[size, half]`: its own, or three quarters of it, a quarter of a neighbour."""
    half, own = (size + 1) // 2, np.arange(size) // 2
    other = np.clip(own + np.where(np.arange(size) % 2, 1, -1), 0, half - 1) if upsampling == "linear" else own
    out = np.zeros((size, half))
    np.add.at(out, (np.arange(size), own), 0.75)
    np.add.at(out, (np.arange(size), other), 0.25)
    return out
