"""Does a model remember training recordings, or has it learned how they move?"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from keycld_control.paper.measures.frames import beginning
from keycld_envs import system_of
from keycld_envs.collect import PAPER_ACTION_RANGE
from keycld_envs.recordings import Dataset
from keycld_envs.recordings.dataset import Sequences
from keycld_model import WorldModel
from keycld_model.evaluation import squared_error, threshold, valid_frames
from keycld_model.evaluation.joint_coordinates import wrap


def memory(
    model: WorldModel, training: Dataset, test: Dataset, errors: Sequence[float], frames: int = 50
) -> dict[str, Any]:
    """Errors of predictions against the distance to the nearest training recording, and what replaying that gives.

    Args:
        model: the world model.
        training: recordings that it was trained with.
        test: recordings that it has not seen, that start at rest with actions that are constant.
        errors: mean squared error of its predictions of each test recording.
        frames: of each recording.

    Returns:
        "distance" and "error" per test recording; "spearman", their rank correlation, and its "p_value"; "replay_vpt",
        the valid prediction time of the nearest training recording.
    """
    assert model.system is not None
    hinges = np.array([joint.kind == "hinge" for joint in system_of(model.system).joints])
    known, new = beginning(training, frames), beginning(test, frames)
    apart = distances(known, new, hinges)
    nearest = known.frames[apart.argmin(axis=1)]
    replayed = np.array([squared_error(k / np.float32(255), f) for k, f in zip(nearest, new.frames, strict=True)])
    rank, p_value = np.asarray(spearmanr(apart.min(axis=1), errors), float)
    return {
        "distance": apart.min(axis=1).tolist(),
        "error": list(errors),
        "spearman": float(rank),
        "p_value": float(p_value),
        "replay_vpt": float(np.mean(valid_frames(replayed, threshold(model, known.frames))) / frames),
    }


def distances(known: Sequences, new: Sequences, hinges: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Between starts and actions `[new, known]`: rad, m, and actions relative to the paper's range, root of squares."""
    assert known.qpos is not None and new.qpos is not None
    poses = new.qpos[:, None, 0] - known.qpos[None, :, 0]
    poses = np.where(hinges, wrap(poses), poses)
    actions = (new.actions[:, None, 0] - known.actions[None, :, 0]) / PAPER_ACTION_RANGE
    return np.sqrt((poses**2).sum(axis=-1) + (actions**2).sum(axis=-1))
