"""Videos of pendulums with known angles, drawn with NumPy and compressed like a camera's."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_envs.recordings.video import write_video
from keycld_model.tracking.pendulum.motion import Motion

Array = NDArray[np.float64]
CAMERA = {"codec": "libx264", "output_params": ["-crf", "23", "-preset", "fast"]}


def nothing(steps: int = 1, note: str | None = None) -> None:
    """A progress bar that shows nothing."""


def swing(times: Array, terms: tuple[str, ...] = ("viscous_friction",), sizes: tuple[float, ...] = (0.1,)) -> Array:
    """Angles of a free pendulum of period 1.2 s, from 0.6 rad at rest."""
    parameters = np.array([[2 * np.log(2 * np.pi / 1.2), 0.0, 0.6, 0.0, *sizes]])
    return Motion(terms).simulate(parameters, times)[0]


def draw_pendulum(
    path: Path, angles: Array, size: tuple[int, int], pivot: Array, length: float, *, fps: float = 30.0,
    hidden: slice | None = None, seed: int = 0,
) -> Array:  # fmt: skip
    """Write a video of a bob on a string before a textured wall, with noise.

    Args:
        path: ends in .mp4.
        angles: [T], rad, from the downward direction, counter-clockwise.
        size: (W, H), pixels.
        pivot: [2], pixels; may lie outside.
        length: pixels.
        fps: frames per second.
        hidden: frames in which the bob is covered.
        seed: of the wall and of the noise.

    Returns:
        [T, 2], true centres of the bob, pixels.
    """
    rng = np.random.default_rng(seed)
    width, height = size
    wall = 170 + 25 * gaussian_filter(rng.normal(size=(height, width)), 6) * 6
    wall = np.repeat(wall[..., None], 3, axis=2)
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    bobs = pivot + length * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    radius = 0.035 * width

    def frames():
        for t, (bx, by) in enumerate(bobs):
            image = wall.copy()
            if hidden is None or not hidden.start <= t < hidden.stop:
                dx, dy = np.array([bx, by]) - pivot
                across = np.abs((x - pivot[0]) * dy - (y - pivot[1]) * dx) / length
                string = np.clip(1.5 - across, 0, 1) * ((x - bx) * dx + (y - by) * dy < 0)
                bob = np.clip(radius + 0.5 - np.hypot(x - bx, y - by), 0, 1)
                image += string[..., None] * (np.array([60, 60, 70]) - image)
                image += bob[..., None] * (np.array([190, 40, 50]) - image)
            yield np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)

    write_video(path, frames(), size, fps, **CAMERA)
    return bobs
