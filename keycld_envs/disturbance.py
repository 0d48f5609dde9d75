"""Images of a camera that is not quite the scene's: moved, in another light, blurred, noisy, compressed."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.checks import LARGEST_SIDE, check_number, check_whole, short
from keycld_envs.errors import InputError
from keycld_envs.rendering import Renderer, View

Given = TypeVar("Given", bound="Disturbance")


@dataclass(frozen=True)
class Disturbance:
    """What a camera does to the images of a scene, in this order.

    Attributes:
        right: image content is shifted to the right, pixels.
        up: and upwards, pixels.
        zoom: factor of lengths.
        aspect: factor of horizontal lengths beside it.
        roll: image content is turned counter-clockwise about the centre, rad.
        pitch: the camera is turned upwards, rad, and what was in the middle of the image stays there (keystone).
        yaw: the same to the right.
        blur: standard deviation of a Gaussian, pixels.
        gain: factors of red, green and blue.
        offset: added to all three, grey levels, 0 to 255.
        noise: standard deviation of every pixel, anew in every image, grey levels.
        jpeg: quality of the compression, 1 to 100; None for none.

    Raises:
        InputError: if a number is none, or none that a camera can have.
    """

    right: float = 0.0
    up: float = 0.0
    zoom: float = 1.0
    aspect: float = 1.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    blur: float = 0.0
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: float = 0.0
    noise: float = 0.0
    jpeg: int | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            check_number(name, getattr(self, name), low, high, inclusive=True)
        if not isinstance(self.gain, Sequence) or len(self.gain) != 3:
            raise InputError(f"gain is {short(self.gain)}; it must be three factors, of red, green and blue.")
        for factor in self.gain:
            check_number("gain", factor, 0.0, 1e3, inclusive=True)
        if self.jpeg is not None:
            check_whole("jpeg", self.jpeg, 1, 100)

    @classmethod
    def parse(cls: type[Given], words: Mapping[str, str]) -> Given:
        """Read numbers by name, as the command line has them: `{"brightness": "0.7", "shift": "2,-1"}`.

        Args:
            words: "shift" (RIGHT or RIGHT,UP), "brightness" (ALL or RED,GREEN,BLUE), "offset", "zoom",
                "roll", "pitch", "yaw", "blur", "noise" or "jpeg", each with its numbers.

        Raises:
            InputError: if a name is none of these, or its numbers are none, too many, or out of range.
        """
        fields: dict[str, Any] = {}
        for name, text in words.items():
            if name not in _NUMBERS:
                raise InputError(f"There is no disturbance {name!r}; there are {', '.join(_NUMBERS)}.")
            fields |= _NUMBERS[name](name, text)
        return cls(**fields)

    @cached_property
    def view(self) -> View:
        """As the renderer takes it."""
        return View(self.right, self.up, self.zoom, self.aspect, self.roll, self.pitch, self.yaw)

    def develop(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """What the camera makes of an ideal image `[H, W, 3]` in its view."""
        from scipy.ndimage import gaussian_filter

        out = gaussian_filter(image.astype(np.float64), (self.blur, self.blur, 0))
        out = out * self.gain + self.offset + rng.normal(0, self.noise, image.shape)
        frame = np.clip(np.round(out), 0, 255).astype(np.uint8)
        if self.jpeg is None:
            return frame

        import imageio.v3 as iio

        with io.BytesIO() as file:
            iio.imwrite(file, frame, extension=".jpg", quality=self.jpeg)
            return np.asarray(iio.imread(file.getvalue(), extension=".jpg"))


def seen(
    disturbance: Disturbance | None, renderer: Renderer, data: mujoco.MjData, camera: str, moment: Sequence[int]
) -> NDArray[np.uint8]:
    """Image `[H, W, 3]` of a state by a camera of the model, disturbed or not.

    Args:
        disturbance: of the camera; None for none.
        renderer: draws.
        data: the state, whose kinematics must be up to date.
        camera: name of the camera.
        moment: whole numbers, not negative, that tell this image's noise from that of others.
    """
    if disturbance is None:
        return renderer.render(data, camera)
    return disturbance.develop(renderer.render(data, camera, disturbance.view), np.random.default_rng(moment))


_RANGES = {
    "right": (-LARGEST_SIDE, LARGEST_SIDE),
    "up": (-LARGEST_SIDE, LARGEST_SIDE),
    "zoom": (0.01, 100.0),
    "aspect": (0.01, 100.0),
    "roll": (-1e3, 1e3),
    "pitch": (-1.0, 1.0),
    "yaw": (-1.0, 1.0),
    "blur": (0.0, 100.0),
    "offset": (-255.0, 255.0),
    "noise": (0.0, 255.0),
}
"""Least and greatest, in units of the attributes."""


def _read(name: str, text: str, counts: Sequence[int], low: float, high: float) -> list[float]:
    """Numbers of a text, as many as may be and within bounds."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(low <= number <= high for number in numbers):
        how_many = " or ".join(map(str, counts))
        raise InputError(f"{name} is {text!r}; it takes {how_many} number(s) from {low:g} to {high:g}.")
    return numbers


def _one(field: str, low: float, high: float) -> Any:
    return lambda name, text: {field: _read(name, text, (1,), low, high)[0]}


_NUMBERS = {
    "shift": lambda name, text: dict(zip(("right", "up"), _read(name, text, (1, 2), -32, 32), strict=False)),
    "zoom": _one("zoom", 0.5, 2),
    "roll": _one("roll", -1, 1),
    "pitch": _one("pitch", -1, 1),
    "yaw": _one("yaw", -1, 1),
    "brightness": lambda name, text: {"gain": (*(_read(name, text, (1, 3), 0, 10) * 3)[:3],)},
    "offset": _one("offset", -255, 255),
    "blur": _one("blur", 0, 10),
    "noise": _one("noise", 0, 255),
    "jpeg": lambda name, text: {"jpeg": round(_read(name, text, (1,), 1, 100)[0])},
}
