"""What is true of the mechanism that was recorded."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs import System, get_system


def simulator(system: str, finer: int = 1) -> tuple[mujoco.MjModel, int]:
    """The plant as recordings are made, whatever the actions, in steps that are finer; and how many make a frame."""
    what = get_system(system)
    plant = what.compile()
    plant.actuator_ctrllimited[:] = 0
    steps = finer * round(what.timestep / plant.opt.timestep)
    plant.opt.timestep /= finer
    return plant, steps


def energy(
    plant: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: NDArray[np.floating],
    qvel: NDArray[np.floating] | float = 0.0,
) -> tuple[float, float]:
    """Kinetic and potential energy, J, of a state; `data` is overwritten."""
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(plant, data)
    mujoco.mj_energyPos(plant, data)
    mujoco.mj_energyVel(plant, data)
    return float(data.energy[1]), float(data.energy[0])


def rod_lengths(system: System) -> NDArray[np.float64]:
    """Lengths `[R]` of the rods between the point masses that stand for the bodies, m."""
    plant = system.compile()
    data = mujoco.MjData(plant)
    mujoco.mj_forward(plant, data)
    return np.array([float(np.linalg.norm(end - start)) for start, end in rods(system, data)])


def rods(system: System, data: mujoco.MjData) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """World positions, m, of both ends of every rod."""
    points = mass_points(system, data)
    return [(data.xanchor[0] if r.start is None else points[r.start], points[r.end]) for r in system.mechanism.rods]


def mass_points(system: System, data: mujoco.MjData) -> list[NDArray[np.float64]]:
    """World positions, m, of the masses that stand for the bodies: `mass_position`, or else the landmark's own."""
    bodies = [data.body(mark.body) for mark in system.landmarks]
    local = [mark.position if mark.mass_position is None else mark.mass_position for mark in system.landmarks]
    return [b.xpos + b.xmat.reshape(3, 3) @ np.asarray(at) for b, at in zip(bodies, local, strict=True)]
