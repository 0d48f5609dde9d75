"""Images, actions and keypoints as a model needs them, or a sentence that says what is wrong."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.errors import InputError

Floats = NDArray[np.float32]


def images_of(images: ArrayLike, image_shape: tuple[int, int]) -> NDArray[Any]:
    """Images `[..., H, W, 3]`, uint8 or float32 in 0 to 1."""
    array = np.asarray(images)
    h, w = image_shape
    if array.ndim < 3 or array.shape[-3:] != (h, w, 3):
        raise InputError(f"images has shape {array.shape}; this model needs [..., {h}, {w}, 3].")
    if array.dtype != np.uint8:
        array = array.astype(np.float32)
        if not np.isfinite(array).all() or array.min(initial=0.0) < -1e-3 or array.max(initial=0.0) > 1 + 1e-3:
            raise InputError("images holds values outside 0 to 1, or NaN; give uint8, or floats divided by 255.")
    return array


def actions_of(actions: ArrayLike, steps: int, num_actions: int) -> Floats:
    """The first actions, `[steps, m]`."""
    array = np.asarray(actions, np.float32)
    if array.ndim != 2 or array.shape[1] != num_actions or len(array) < steps:
        raise InputError(
            f"actions has shape {array.shape}; {steps + 1} frames need [{steps}, {num_actions}] or longer."
        )
    bad = np.flatnonzero(~np.isfinite(array[:steps]).all(axis=1))
    if bad.size:
        raise InputError(f"actions[{bad[0]}] is not finite; every action must be a number.")
    return array[:steps]


def keypoints_of(x: ArrayLike, num_keypoints: int) -> Floats:
    """Keypoints `[..., K, 2]`, image units."""
    array = np.asarray(x, np.float32)
    if array.shape[-2:] != (num_keypoints, 2):
        raise InputError(f"x has shape {array.shape}; this model needs keypoints of shape [..., {num_keypoints}, 2].")
    return array


def sequences_of(
    images: ArrayLike, actions: ArrayLike, image_shape: tuple[int, int], num_actions: int
) -> tuple[NDArray[Any], Floats]:
    """First frames `[N, C, H, W, 3]` of sequences, and all their actions `[N, T-1, m]`."""
    frames, u = images_of(images, image_shape), np.asarray(actions, np.float32)
    if frames.ndim != 5 or u.ndim != 3 or len(frames) != len(u) or not 2 <= frames.shape[1] <= u.shape[1] + 1:
        raise InputError(
            f"images has shape {frames.shape} and actions {u.shape}; a rollout needs [N, C, H, W, 3] and "
            "[N, T-1, m] with 2 <= C <= T."
        )
    return frames, np.stack([actions_of(a, len(a), num_actions) for a in u])
