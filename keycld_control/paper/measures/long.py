"""Beyond the paper's 50 frames: angles, frames, energy and constraints over up to fifty natural times."""

from functools import partial
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.angles import angle_table
from keycld_control.paper.measures.frames import beginning, curve
from keycld_envs import get_system, system_of
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.evaluation.joint_coordinates import joint_positions
from keycld_model.world_model import CONTEXT_FRAMES

LENGTHS = {"pendulum": 0.5, "cartpole": 0.71394, "acrobot": 1.0}
"""m: of the links whose swing is the natural time T = sqrt(L/g)."""
NATURAL = (10, 50)
FRAMES = (500, 1000)
GRAVITY = 9.81


def natural_frames(system: str, times: float) -> int:
    """Frames in so many natural times."""
    return round(times * float(np.sqrt(LENGTHS[system] / GRAVITY)) / get_system(system).timestep)


def horizon(system: str) -> int:
    """Frames that recordings for these measures have."""
    return max(*FRAMES, *(natural_frames(system, n) for n in NATURAL)) + 1


def over_time(model: WorldModel, system: str, test: Dataset) -> dict[str, Any]:
    """Valid fractions of frames and angles for some lengths, and the deviation from the constraints."""
    lengths = {**{f"{n} frames": n for n in FRAMES}, **{f"{n} T": natural_frames(system, n) for n in NATURAL}}
    out: dict[str, Any] = {}
    for title, frames in lengths.items():
        whole = curve(model, test, frames)
        angles = angle_table(model, test, frames)
        out[title] = {
            "frames": frames,
            "vpt": whole["vpt"],
            "valid": whole["valid"],
            "angle_vpt": angles["mean"],
            "angle_valid": angles["valid"],
        }
    return out | {"off_constraints": _off_constraints(model, test, FRAMES[-1])}


def true_energy(model: WorldModel, test: Dataset, frames: int) -> dict[str, Any]:
    """True energy at the predicted states of recordings without actions, whose true energy is constant.

    Joint positions are decoded from the predicted keypoints, velocities are differences of those around.

    Returns:
        Per recording the largest deviation from its own start, relative to the range of the true potential.
    """
    assert model.system is not None
    quiet = tuple(r for r in test.recordings if not np.any(np.asarray(r.action)))
    system = system_of(model.system)
    if not quiet:
        return {"change": [], "frames": frames}
    plant = system.compile()
    stacked = beginning(Dataset(test.folder, quiet), frames)
    positions, _ = model.rollout(stacked.frames[:, :CONTEXT_FRAMES], stacked.actions)
    assert stacked.qpos is not None
    kinds = [joint.kind for joint in system.joints]
    decoded = joint_positions(model.mechanism, kinds, positions, stacked.qpos[:, :CONTEXT_FRAMES])
    speed = np.gradient(decoded, model.timestep, axis=1)
    energy = np.apply_along_axis(partial(_energy, plant), 2, np.concatenate([decoded, speed], axis=2))
    size = np.ptp([_energy(plant, np.concatenate([q, np.zeros(plant.nv)]))[1] for q in _poses(plant)])
    change = np.abs(energy.sum(-1) - energy.sum(-1)[:, 1:2])[:, 1:-1].max(axis=1) / size
    return {"change": change.tolist(), "frames": frames}


def _energy(plant: mujoco.MjModel, state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Kinetic and potential, J."""
    data = mujoco.MjData(plant)
    data.qpos[:], data.qvel[:] = state[: plant.nq], state[plant.nq :]
    mujoco.mj_forward(plant, data)
    mujoco.mj_energyPos(plant, data)
    mujoco.mj_energyVel(plant, data)
    return np.array([data.energy[1], data.energy[0]])


def _poses(plant: mujoco.MjModel) -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform(-np.pi, np.pi, (500, plant.nq))


def _off_constraints(model: WorldModel, test: Dataset, frames: int) -> float:
    """Median of the largest |Phi - level| along rollouts."""
    stacked = beginning(test, frames)
    positions, _ = model.rollout(stacked.frames[:, :CONTEXT_FRAMES], stacked.actions)
    return float(np.median(np.abs(model.constraint(positions)).max(axis=(1, 2))))
