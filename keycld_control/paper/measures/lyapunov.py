"""How fast the true mechanism forgets where it was: what no model can predict beyond."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.plant import simulator
from keycld_envs import get_system
from keycld_envs.recordings.dataset import Sequences

OFFSET = 1e-7
"""Distance of the twin, in rad or m, and rad/s or m/s times T; brought back to it after every frame."""


def lyapunov(system: str, truth: Sequences, valid: Sequence[float]) -> dict[str, Any]:
    """Largest Lyapunov exponent along every recording (Benettin et al., 1980), and how far predictions got beside it.

    Args:
        system: short name; its plant moves from the recordings' first pose, at rest, under their actions.
        truth: recordings.
        valid: fractions of the frames for which predictions were right, per recording.

    Returns:
        "exponents", 1/s, per recording; "time", s, one over their median; "valid", how many Lyapunov times of its own
        recording each prediction was right for; "median_valid".
    """
    assert truth.qpos is not None
    exponents = [exponent(system, q[0], u) for q, u in zip(truth.qpos, truth.actions, strict=True)]
    seconds = truth.frames.shape[1] * truth.timestep
    times = [v * seconds * max(e, 0.0) for v, e in zip(valid, exponents, strict=True)]
    middle = float(np.median(exponents))
    return {
        "exponents": exponents,
        "time": 1 / middle if middle > 0 else None,
        "valid": times,
        "median_valid": float(np.median(times)),
    }


def exponent(system: str, qpos: NDArray[np.floating], actions: NDArray[np.floating]) -> float:
    """Mean growth rate, 1/s, of a small offset of a state at rest under actions `[T-1, m]`."""
    plant, substeps = simulator(system)
    one, twin = mujoco.MjData(plant), mujoco.MjData(plant)
    direction = np.random.default_rng(0).normal(size=2 * plant.nv)
    offset, growth = OFFSET * direction / np.linalg.norm(direction), 0.0
    one.qpos[:] = qpos
    for action in actions:
        twin.qpos[:], twin.qvel[:] = one.qpos + offset[: plant.nv], one.qvel + offset[plant.nv :]
        for data in (one, twin):
            data.ctrl[:] = action
            mujoco.mj_step(plant, data, substeps)
        apart = np.concatenate([twin.qpos - one.qpos, twin.qvel - one.qvel])
        growth += np.log(np.linalg.norm(apart) / OFFSET)
        offset = OFFSET * apart / np.linalg.norm(apart)
    return float(growth / (len(actions) * get_system(system).timestep))
