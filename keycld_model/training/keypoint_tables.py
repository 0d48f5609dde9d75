"""Keypoints of all frames, and their local polynomials."""

import jax
import numpy as np
from numpy.typing import NDArray

from keycld_model.modules import Parts
from keycld_model.training.data import TrainingData
from keycld_model.training.stage import Variables


def keypoint_table(parts: Parts, variables: Variables, data: TrainingData, chunk: int = 50) -> NDArray[np.float32]:
    """Keypoints of all training frames, `[N, T, n]`; computed once as long as the estimator stays the same object."""
    estimator = variables["estimator"]
    if data.memory.get("estimator") is not estimator:
        function = jax.jit(lambda estimator, images: parts.keypoints({"estimator": estimator}, images))
        frames = data.flat_frames
        rows = [np.asarray(function(estimator, frames[i : i + chunk])) for i in range(0, len(frames), chunk)]
        table = np.concatenate(rows).reshape(data.num_sequences, data.length, -1)
        data.memory.update(estimator=estimator, table=table)
    return data.memory["table"]


def local_polynomials(
    keypoints: NDArray[np.float32], timestep: float, window: int = 5, degree: int = 3
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smoothed positions and velocities at every frame, from polynomials through its neighbours (Savitzky-Golay).

    Args:
        keypoints: `[N, T, n]`.
        timestep: seconds between frames.
        window: frames per polynomial.
        degree: of the polynomial.

    Returns:
        Positions and velocities `[N, T, n]`.
    """
    length = keypoints.shape[1]
    positions, velocities = np.empty_like(keypoints), np.empty_like(keypoints)
    for t in range(length):
        first = min(max(t - window // 2, 0), length - window)
        times = (np.arange(first, first + window) - t) * timestep
        filters = np.linalg.pinv(np.vander(times, degree + 1, increasing=True))
        part = keypoints[:, first : first + window]
        positions[:, t] = np.einsum("w,nwd->nd", filters[0], part)
        velocities[:, t] = np.einsum("w,nwd->nd", filters[1], part)
    return positions, velocities
