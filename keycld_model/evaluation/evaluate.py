"""One table of scores of a world model on a data set of recordings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from keycld_envs import system_of
from keycld_envs.errors import InputError
from keycld_envs.recordings import Dataset, Sequences
from keycld_envs.registration import same_system
from keycld_model.evaluation.joint_coordinates import circular_r2, joint_angles, linear_r2, matched, slider_positions
from keycld_model.evaluation.valid_prediction_time import (
    frame_errors,
    prediction_errors,
    static_error,
    threshold,
    valid_frames,
)
from keycld_model.redundancy import told_by_others
from keycld_model.world_model import CONTEXT_FRAMES, WorldModel


@dataclass(frozen=True)
class Evaluation:
    """Scores; errors are means over pixels and channels of values in 0 to 1.

    Attributes:
        system: environment id, or None.
        split: "validation" if the data set is the one the model was trained on, of which only the held-out part
            counts; "all" otherwise.
        sequences: how many.
        frames: frames per sequence.
        context: frames that each prediction starts from (they count as predicted: the model redraws them).
        epsilon: mean squared error of the mean training frame, the threshold of validity.
        vpt_fraction: fraction of the frames that are valid (KeyCLD paper, equation 16), mean over sequences.
        vpt_interval: its 95 % bootstrap interval.
        vpt_full: sequences that stay valid to the end.
        vpt_frame_index: the 2024 code's figure: index of the last valid frame, threshold from the evaluated data.
        reconstruction_mse: error of drawing each frame from its own keypoints.
        keypoint_contributions: per keypoint, by how much of epsilon that error grows if it is where the others say
            (linear regression); near 0, the keypoint rides on the same part as another one.
        circular_r2: per joint, agreement of decoded and recorded positions (squared correlation for slides); None
            where joint positions are not recorded.
        constraint_residual: median deviation of rod lengths and slider offsets from their constants, image units.
    """

    system: str | None
    split: str
    sequences: int
    frames: int
    context: int
    epsilon: float
    vpt_fraction: float
    vpt_interval: tuple[float, float]
    vpt_full: int
    vpt_frame_index: float
    reconstruction_mse: float
    keypoint_contributions: tuple[float, ...]
    circular_r2: dict[str, float] | None
    constraint_residual: float


def evaluate(model: WorldModel, dataset: Dataset, context: int = CONTEXT_FRAMES, frames: int = 50) -> Evaluation:
    """Score a world model.

    Args:
        model: the model, with the threshold epsilon from its training in `model.meta`.
        dataset: recordings; of the model's own training set only the held-out part is used.
        context: frames that each prediction starts from, at least 2.
        frames: recordings are cut into sequences of at most this many frames.

    Raises:
        InputError: if the recordings are of another system, size or frame rate, or have other actions.
    """
    stacked = counted_sequences(model, dataset, frames)
    n, t = stacked.frames.shape[:2]
    if not 2 <= context <= t:
        raise InputError(f"context is {context}; it must be between 2 and the {t} frames of a sequence.")
    epsilon = threshold(model, stacked.frames)
    errors = prediction_errors(model, stacked.frames, stacked.actions, context)
    fractions = valid_frames(errors, epsilon) / t
    keypoints = model.keypoints(stacked.frames)
    index = np.minimum(valid_frames(errors, static_error(stacked.frames)), t - 1)
    return Evaluation(
        system=model.system,
        split="validation" if _own(model, dataset) else "all",
        sequences=n,
        frames=t,
        context=context,
        epsilon=epsilon,
        vpt_fraction=float(fractions.mean()),
        vpt_interval=_interval(fractions),
        vpt_full=int((fractions == 1).sum()),
        vpt_frame_index=float(index.mean()),
        reconstruction_mse=(drawn := float(frame_errors(model, keypoints, stacked.frames).mean())),
        keypoint_contributions=_contributions(model, keypoints, stacked.frames, drawn, epsilon),
        circular_r2=_agreement(model, keypoints, stacked.qpos),
        constraint_residual=_constraint_residual(model, keypoints),
    )


def counted_sequences(model: WorldModel, dataset: Dataset, frames: int = 50) -> Sequences:
    """The sequences that an evaluation counts: of the model's own training set, the held-out ones, of others, all.

    Raises:
        InputError: as `evaluate`.
    """
    if frames < 2:
        raise InputError(f"frames is {frames}; a sequence needs at least 2.")
    if model.system is not None and dataset.system is not None and not same_system(model.system, dataset.system):
        raise InputError(
            f"{model.name} is a model of {model.system}, {dataset.folder} records {dataset.system}; evaluate it on "
            "recordings of its own system."
        )
    if _own(model, dataset) and model.meta:
        dataset = dataset.split(model.meta["validation"])[1]
    stacked = dataset.sequences().cut(frames)
    if (size := stacked.frames.shape[2:4]) != model.image_shape:
        raise InputError(
            f"{dataset.folder} has frames of shape [{size[0]}, {size[1]}, 3], {model.name} sees "
            f"[{model.image_shape[0]}, {model.image_shape[1]}, 3]; record at that size, or cut larger ones with "
            "`keycld crop`."
        )
    if (found := stacked.actions.shape[-1]) != (wanted := model.mechanism.num_actions):
        raise InputError(
            f"{dataset.folder} has {found} actions per frame, {model.name} needs {wanted}; "
            "record what its actuators did (zeros, if nothing)."
        )
    if abs(stacked.timestep / model.timestep - 1) > 0.05:
        raise InputError(
            f"{dataset.folder} has a frame every {stacked.timestep:g} s, {model.name} was trained on "
            f"{model.timestep:g} s; record at that rate."
        )
    return stacked


def _own(model: WorldModel, dataset: Dataset) -> bool:
    """Whether the model was trained on this data set."""
    return (model.meta or {}).get("data", {}).get("sha256") == dataset.sha256


def _interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """95 % percentile bootstrap interval of the mean."""
    if len(values) < 2 or np.ptp(values) == 0:
        return float(values.mean()), float(values.mean())
    result = bootstrap((values,), np.mean, method="percentile", rng=np.random.default_rng(0))
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def _agreement(
    model: WorldModel, keypoints: NDArray[np.float32], qpos: NDArray[np.float64] | None
) -> dict[str, float] | None:
    """R squared per joint; hinges go with rods (see `matched`) and slides with sliders, each in order."""
    if qpos is None or model.system is None or not np.isfinite(qpos).all():
        return None
    joints = system_of(model.system).joints
    angles = joint_angles(model.mechanism, keypoints)
    slides = slider_positions(model.mechanism, keypoints)
    kinds = [joint.kind for joint in joints]
    if (kinds.count("hinge"), kinds.count("slide")) != (angles.shape[-1], slides.shape[-1]):
        return None
    angles = matched(model.mechanism, angles, qpos[..., [kind == "hinge" for kind in kinds]])
    scores, seen = {}, {"hinge": 0, "slide": 0}
    for i, joint in enumerate(joints):
        decoded = (angles if joint.kind == "hinge" else slides)[..., seen[joint.kind]]
        seen[joint.kind] += 1
        scores[joint.name] = (circular_r2 if joint.kind == "hinge" else linear_r2)(decoded, qpos[..., i])
    return scores


def _contributions(
    model: WorldModel, keypoints: NDArray[np.float32], frames: NDArray[np.uint8], drawn: float, epsilon: float
) -> tuple[float, ...]:
    """What each keypoint adds to what the others tell, over epsilon."""
    flat, out = keypoints.reshape(-1, 2 * keypoints.shape[-2]), []
    for k in range(keypoints.shape[-2]):
        told = told_by_others(flat, k).reshape(keypoints.shape)
        out.append(float((frame_errors(model, told, frames).mean() - drawn) / epsilon))
    return tuple(out)


def _constraint_residual(model: WorldModel, keypoints: NDArray[np.float32]) -> float:
    """Median over frames and constraints; a rod's constraint is half its squared length."""
    level = model.level
    phi = model.constraint(keypoints) + level
    rods = len(model.mechanism.rods)
    lengths, constants = phi.copy(), level.copy()
    lengths[..., :rods] = np.sqrt(2 * np.maximum(phi[..., :rods], 0))
    constants[:rods] = np.sqrt(2 * np.maximum(level[:rods], 0))
    return float(np.median(np.abs(lengths - constants)))
