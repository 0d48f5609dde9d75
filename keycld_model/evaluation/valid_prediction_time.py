"""Valid prediction time (Botev et al. 2021; KeyCLD paper, equation 16)."""

import numpy as np
from numpy.typing import NDArray

from keycld_model.world_model import CONTEXT_FRAMES, WorldModel


def static_error(frames: NDArray[np.uint8]) -> float:
    """epsilon: mean squared error per value of the mean frame, the best prediction that never moves.

    Args:
        frames: [N, T, H, W, 3] uint8; use training data, so that the threshold is not tuned to what is scored.

    Returns:
        Mean over all pixels and channels, for values in 0 to 1.
    """
    total = np.zeros(frames.shape[2:], np.float64)
    squares = 0.0
    for sequence in frames:
        values = sequence.astype(np.float32) / 255.0
        total += values.sum(axis=0, dtype=np.float64)
        squares += float(np.sum(values**2, dtype=np.float64))
    count = frames.shape[0] * frames.shape[1]
    mean = total / count
    return float(squares / count / mean.size - np.mean(mean**2))


def prediction_errors(
    model: WorldModel,
    frames: NDArray[np.uint8],
    actions: NDArray[np.floating],
    context: int = CONTEXT_FRAMES,
    refine: bool = True,
) -> NDArray[np.float64]:
    """Mean squared error of every predicted frame, [N, T].

    Args:
        model: the world model.
        frames: [N, T, H, W, 3] uint8, the truth.
        actions: [N, T-1, m].
        context: frames the prediction starts from; the prediction covers them too.
        refine: fit the initial state to the pixels, not only to the keypoints.
    """
    return frame_errors(model, model.rollout(frames[:, :context], actions, refine)[0], frames)


def frame_errors(model: WorldModel, positions: NDArray[np.floating], frames: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Mean squared error [N, T] of frames drawn of predicted keypoints.

    Args:
        model: the world model.
        positions: [N, T, K, 2], image units.
        frames: [N, T, H, W, 3] uint8, the truth.
    """
    errors = np.empty(frames.shape[:2])
    for i, sequence in enumerate(frames):
        errors[i] = squared_error(model.render(positions[i]), sequence)
    return errors


def squared_error(predicted: NDArray[np.float32], truth: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Mean squared error `[T]` per value of images `[T, H, W, 3]`, the predicted ones in 0 to 1."""
    return ((predicted - truth.astype(np.float32) / 255.0) ** 2).mean(axis=(1, 2, 3))


def threshold(model: WorldModel, frames: NDArray[np.uint8]) -> float:
    """epsilon of a model's training data; of these frames, if the model does not know it."""
    return (model.meta or {}).get("epsilon") or static_error(frames)


def valid_frames(errors: NDArray[np.floating], epsilon: float) -> NDArray[np.int64]:
    """Frames [N] before the error [N, T] first exceeds epsilon or is not finite; T if it never does."""
    bad = ~(errors <= epsilon)
    return np.where(bad.any(axis=1), bad.argmax(axis=1), errors.shape[1])
