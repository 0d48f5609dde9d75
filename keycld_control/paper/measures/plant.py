"""What is true of the mechanism that was recorded."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs import get_system


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
