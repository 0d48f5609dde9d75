"""The error of positions that were read off frames: frames are drawn at known positions and read again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.follow import follow
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import Pose
from keycld_model.image_alignment.scene import Scene

Array = NDArray[np.float64]
READ_AGAIN = 160
"""Frames that are read again: standard deviations come out within 6 %."""


def reading_error(
    scene: Scene,
    look: Array,
    light: Light,
    times: Array,
    frames: NDArray[np.uint8],
    poses: Sequence[Pose],
    bank: Bank,
    seed: int = 0,
) -> Array:
    """Root mean square error of each joint, `[nq]`, rad or m (a parametric bootstrap).

    The positions that were read are drawn with the look and the light that were fitted and with the noise that pixels
    have, and read again. What pixels do to edges, which repeats along a path and is no white noise, is so included.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        times: `[T]` of its frames, s.
        frames: `[T, H, W, 3]`.
        poses: that were read off them.
        bank: drawings of the scene.
        seed: of the noise.
    """
    rng, part = np.random.default_rng(seed), slice(0, READ_AGAIN)
    drawn = [light.apply(scene.render(pose.q, look)) for pose in poses[part]]
    left = np.stack(drawn[::8]) - frames[part][::8]
    noise = 1.4826 * float(np.median(np.abs(left - np.median(left))))
    shown = [np.clip(np.round(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8) for image in drawn]
    again = follow(scene, look, light, times[part], np.stack(shown), bank)
    error = np.array([pose.q - known.q for pose, known in zip(again, poses[part], strict=True)])
    error -= np.median(error, axis=0)  # whole turns among them
    return np.sqrt(np.mean(error**2, axis=0))
