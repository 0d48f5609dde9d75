"""The error of positions that were read off frames: frames are drawn at known positions and read again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from keycld_model.autocorrelation import samples_together
from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.follow import follow
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import Pose
from keycld_model.image_alignment.scene import STEP, Scene

Array = NDArray[np.float64]
READ_AGAIN = 40
"""Frames of a recording that are read again."""
APART = 1.0
"""Pixels; what a frame shows beside its drawing is of another edge where the mechanism is so far away, at least."""


def reading_error(
    scene: Scene,
    look: Array,
    light: Light,
    times: Array,
    frames: NDArray[np.uint8],
    poses: Sequence[Pose],
    bank: Bank,
) -> Array:
    """Errors of the joints in the first readable frames of a recording, `[T, nq]`, rad or m (a bootstrap of residuals).

    The positions that were read are drawn with the look and the light that were fitted, get what another frame shows
    beside its own drawing, and are read again. The other frame is the one whose positions are nearest, but for those
    that are nearer than a pixel: noise, compression, and what pixels do to edges are then as they are here.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        times: `[T]` of its frames, s.
        frames: `[T, H, W, 3]`.
        poses: that were read off them.
        bank: drawings of the scene.
    """
    known = [k for k, pose in enumerate(poses) if pose.readable]
    if not known:
        return np.zeros((0, scene.model.nq))
    frames, part = frames[known], slice(0, READ_AGAIN)
    drawn = np.stack([light.apply(scene.render(poses[k].q, look)) for k in known])
    q = np.array([poses[k].q for k in known])
    others = [_nearest(q, k, scene.joint_steps(q[k], look)) for k in range(len(q[part]))]
    shown = drawn[part] + frames[others] - drawn[others]
    again = follow(scene, look, light, times[known][part], np.clip(np.round(shown), 0, 255).astype(np.uint8), bank)
    error = np.array([pose.q for pose in again]) - q[part]
    error -= np.median(error, axis=0)  # whole turns among them
    return error[[pose.readable for pose in again]]


def frames_together(errors: Sequence[Array]) -> Array:
    """Number of frames `[nq]` over which errors `[T, nq]` of recordings are correlated; see `samples_together`."""
    own = [e - e.mean(axis=0) for e in errors if len(e) > 1]
    if not own:
        return np.ones(errors[0].shape[1])
    return samples_together(
        lambda lag: np.sum([np.mean(e[lag:] * e[: len(e) - lag], axis=0) for e in own], axis=0),
        min(len(e) for e in own) // 2,
    )


def _nearest(q: Array, k: int, steps: Array) -> int:
    """Index of the frame whose positions are nearest to those of frame k, but far enough; of the farthest, if none is.

    Args:
        q: `[T, nq]` positions.
        k: index of the frame.
        steps: `[nq]` changes of each joint that move what is seen by `STEP` pixels.
    """
    distance = STEP * np.abs((q - q[k]) / steps).max(axis=1)
    enough = distance >= APART
    return int(np.argmin(np.where(enough, distance, np.inf)) if enough.any() else np.argmax(distance))
