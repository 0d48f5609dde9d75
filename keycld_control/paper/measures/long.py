"""Beyond the paper's 50 frames: angles, frames, energy and constraints over up to fifty natural times."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.angles import WRONG, angle_table, decode, hinge_errors
from keycld_control.paper.measures.frames import beginning
from keycld_control.paper.measures.plant import energy, rod_lengths
from keycld_envs import get_system
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.evaluation import frame_errors, threshold, valid_frames
from keycld_model.world_model import CONTEXT_FRAMES

NATURAL = (10, 50)
FRAMES = (500, 1000)
INFORMED = 20
"""Frames that show a velocity well."""
GRAVITY = 9.81


def natural_frames(system: str, times: float) -> int:
    """Frames in so many natural times sqrt(L/g), where L is the length of the longest rod between point masses."""
    what = get_system(system)
    return round(times * float(np.sqrt(rod_lengths(what).max() / GRAVITY)) / what.timestep)


def horizon(system: str) -> int:
    """Frames that recordings for these measures have."""
    return max(*FRAMES, *(natural_frames(system, n) for n in NATURAL)) + 1


def beyond(model: WorldModel, system: str, test: Dataset) -> dict[str, Any]:
    """What happens after the paper's last frame, from one rollout of each recording.

    Returns:
        "lengths": valid fractions of frames and angles for some lengths; "off_constraints": median of the largest
        |Phi - level| within 1,000 frames; "true_energy": for every recording without actions, whose true energy is
        constant, the largest change of the true energy at predicted states within 1,000 frames, relative to the range
        of the true potential; "informed": valid fractions of angles over 500 frames from twenty frames, not five,
        which tell how much of the error the start had. Joint positions are decoded from the predicted keypoints,
        velocities are differences.
    """
    lengths = {**{f"{n} frames": n for n in FRAMES}, **{f"{n} T": natural_frames(system, n) for n in NATURAL}}
    stacked = beginning(test, max(lengths.values()))
    positions, _ = model.rollout(stacked.frames[:, :CONTEXT_FRAMES], stacked.actions)
    errors, epsilon = frame_errors(model, positions, stacked.frames), threshold(model, stacked.frames)
    decoded = decode(model, positions, stacked)
    angles = hinge_errors(model, decoded, stacked)
    out: dict[str, Any] = {}
    for title, n in lengths.items():
        valid, right = valid_frames(errors[:, :n], epsilon) / n, valid_frames(angles[:, :n], WRONG) / n
        out[title] = {
            "frames": n,
            "vpt": float(valid.mean()),
            "valid": valid.tolist(),
            "angle_vpt": float(right.mean()),
            "angle_valid": right.tolist(),
        }
    last = FRAMES[-1]
    quiet = ~np.any(stacked.actions, axis=(1, 2))
    return {
        "lengths": out,
        "off_constraints": float(np.median(np.abs(model.constraint(positions[:, :last])).max(axis=(1, 2)))),
        "true_energy": _energy_changes(system, decoded[quiet, :last], model.timestep),
        "informed": angle_table(model, test, FRAMES[0], INFORMED)["valid"],
    }


def _energy_changes(system: str, joints: NDArray[np.floating], timestep: float) -> list[float]:
    """Of trajectories `[N, T, nq]`."""
    plant = get_system(system).compile()
    data = mujoco.MjData(plant)
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (500, plant.nq))
    size = np.ptp([energy(plant, data, q)[1] for q in poses])
    changes = []
    for path in joints:
        speeds = np.gradient(path, timestep, axis=0)
        total = [sum(energy(plant, data, q, v)) for q, v in zip(path[1:-1], speeds[1:-1], strict=True)]
        changes.append(float(np.abs(np.array(total) - total[0]).max() / size))
    return changes
