"""For how long predicted joint angles are right, on which an image's background has no influence."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.frames import beginning
from keycld_envs import system_of
from keycld_envs.recordings import Dataset
from keycld_envs.recordings.dataset import Sequences
from keycld_model import WorldModel
from keycld_model.evaluation.joint_coordinates import joint_positions, wrap
from keycld_model.evaluation.valid_prediction_time import valid_frames
from keycld_model.world_model import CONTEXT_FRAMES

WRONG = 0.2
"""rad."""


def decode(model: WorldModel, positions: NDArray[np.floating], truth: Sequences) -> NDArray[np.floating]:
    """Joint positions `[N, T, nq]` that predicted keypoints show; see `joint_positions`."""
    assert model.system is not None and truth.qpos is not None
    kinds = [joint.kind for joint in system_of(model.system).joints]
    return joint_positions(model.mechanism, kinds, positions, truth.qpos[:, :CONTEXT_FRAMES])


def hinge_errors(model: WorldModel, decoded: NDArray[np.floating], truth: Sequences) -> NDArray[np.float64]:
    """Largest error of any hinge, `[N, T]` rad."""
    assert model.system is not None and truth.qpos is not None
    hinges = [joint.kind == "hinge" for joint in system_of(model.system).joints]
    return np.abs(wrap(decoded - truth.qpos))[..., hinges].max(axis=-1)


def angle_table(model: WorldModel, test: Dataset, frames: int, context: int = CONTEXT_FRAMES) -> dict[str, Any]:
    """Fraction of the frames before an angle is first wrong by more than 0.2 rad, and the median error over time."""
    truth = beginning(test, frames)
    positions, _ = model.rollout(truth.frames[:, :context], truth.actions)
    errors = hinge_errors(model, decode(model, positions, truth), truth)
    valid = valid_frames(errors, WRONG) / errors.shape[1]
    return {
        "valid": valid.tolist(),
        "mean": float(valid.mean()),
        "frames": errors.shape[1],
        "median_error": np.median(errors, axis=0).tolist(),
    }
