"""What is true of the mechanism that was recorded."""

import mujoco
import numpy as np
from numpy.typing import NDArray


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
