"""Keypoints of all frames, their local polynomials, and the trajectories that explain them."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_model.modules import Parts
from keycld_model.places import to_masses
from keycld_model.training.data import TrainingData
from keycld_model.training.stage import Variables

DISTRUST = 0.05
"""Frames whose keypoints are this far (image units) from their trajectory hardly count."""
TRUSTED = 0.5
"""Trust of a frame's keypoints (see `trust`) above which it teaches what parts look like, and poses."""


def keypoint_table(parts: Parts, variables: Variables, data: TrainingData, chunk: int = 50) -> NDArray[np.float32]:
    """Keypoints of all training frames, `[N, T, n]`: those aligned with them, if there are any, or the estimator's.

    The latter are computed once as long as the estimator stays the same object.
    """
    if "aligned" in variables:
        return np.asarray(variables["aligned"])
    estimator = variables["estimator"]
    if data.memory.get("estimator") is not estimator:
        function = jax.jit(lambda estimator, images: parts.keypoints({"estimator": estimator}, images))
        frames = data.flat_frames
        rows = [np.asarray(function(estimator, frames[i : i + chunk])) for i in range(0, len(frames), chunk)]
        table = np.concatenate(rows).reshape(data.num_sequences, data.length, -1)
        data.memory.update(estimator=estimator, table=table)
    return data.memory["table"]


def trajectories(parts: Parts, variables: Variables, data: TrainingData) -> NDArray[np.float32]:
    """Positions `[N, T, n]` of the masses on the fitted trajectories."""

    @jax.jit
    def rollout(dynamics: Variables, x: Array, v: Array, u: Array) -> Array:
        model = parts.dynamics({"dynamics": dynamics})
        return jax.vmap(lambda x, v, u: model.rollout(x, v, u, data.timestep)[0])(x, v, u)

    start = variables["trajectories"]
    return np.asarray(rollout(variables["dynamics"], start["x"], start["v"], data.actions))


def trust(
    parts: Parts, variables: Variables, data: TrainingData, positions: NDArray[np.float32]
) -> NDArray[np.float32]:
    """`[N, T]`, 0 to 1: how much each frame counts, by how far its keypoints are from trajectories `[N, T, n]`."""
    measured = to_masses(parts.config.mechanism, variables, jnp.asarray(keypoint_table(parts, variables, data)))
    error = (positions - np.asarray(measured)).reshape(*positions.shape[:2], -1, 2)
    worst = np.sqrt((error**2).sum(-1)).max(-1)
    return np.exp(-((worst / DISTRUST) ** 2)) * (np.median(worst, axis=1, keepdims=True) < DISTRUST)


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
