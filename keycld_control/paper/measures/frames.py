"""Table 1 and figure 3: for how long predicted frames are valid."""

from typing import Any

import numpy as np

from keycld_envs.recordings import Dataset
from keycld_envs.recordings.dataset import Sequences
from keycld_model import WorldModel
from keycld_model.evaluation import evaluate, prediction_errors, threshold, valid_frames
from keycld_model.world_model import CONTEXT_FRAMES

CONTEXTS = (CONTEXT_FRAMES, 2, 10)
"""Frames that predictions start from."""
BAND = (10, 90)
"""Percentiles of the band around a curve."""


def table_row(model: WorldModel, test: Dataset) -> dict[str, Any]:
    """Valid prediction time in both definitions, from five frames, the paper's two, and ten."""
    out: dict[str, Any] = {}
    for context in CONTEXTS:
        score = evaluate(model, test, context)
        out[f"vpt_from_{context}"] = score.vpt_fraction
        out[f"vpt_from_{context}_interval"] = score.vpt_interval
        out[f"frame_index_from_{context}"] = score.vpt_frame_index
    return out | {
        "sequences": score.sequences,
        "frames": score.frames,
        "epsilon": score.epsilon,
        "reconstruction_mse": score.reconstruction_mse,
        "circular_r2": score.circular_r2,
        "constraint_residual": score.constraint_residual,
    }


def beginning(test: Dataset, frames: int) -> Sequences:
    """The first frames of all recordings, stacked."""
    whole = test.sequences()
    qpos = None if whole.qpos is None else whole.qpos[:, :frames]
    return Sequences(whole.frames[:, :frames], whole.actions[:, : frames - 1], qpos, whole.timestep)


def curve(model: WorldModel, test: Dataset, frames: int = 50, context: int = CONTEXT_FRAMES) -> dict[str, Any]:
    """Mean squared error of every predicted frame: mean and band over recordings, each one's, and what stays valid.

    Args:
        model: the world model.
        test: recordings that it has not seen.
        frames: of each recording, from its first one.
        context: frames that each prediction starts from.
    """
    stacked = beginning(test, frames)
    errors = prediction_errors(model, stacked.frames, stacked.actions, context)
    epsilon = threshold(model, stacked.frames)
    valid = valid_frames(errors, epsilon)
    low, high = np.percentile(errors, BAND, axis=0)
    return {
        "mean": errors.mean(axis=0).tolist(),
        "errors": errors.mean(axis=1).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "epsilon": epsilon,
        "valid": (valid / errors.shape[1]).tolist(),
        "vpt": float(np.mean(valid / errors.shape[1])),
    }
