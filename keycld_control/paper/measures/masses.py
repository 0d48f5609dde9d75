"""Learned masses against those of point masses that move exactly as the bodies do."""

from typing import Any

import mujoco
import numpy as np

from keycld_envs import get_system
from keycld_envs.systems.base import System
from keycld_model import WorldModel

POSES = 20


def mass_ratio(model: WorldModel, system: str) -> dict[str, Any] | None:
    """m1/m2; None for a system with one mass."""
    exact = equivalent_masses(get_system(system))
    if len(exact) < 2:
        return None
    ratio, true = float(model.masses[0] / model.masses[1]), exact[0] / exact[1]
    return {"ratio": ratio, "exact": true, "error": abs(ratio / true - 1)}


def equivalent_masses(system: System) -> list[float]:
    """Point masses, kg, at the mass positions that a system declares, whose inertia in all poses is that of its bodies.

    Least squares over random poses; for the reference systems they agree to 1e-4 (tests/model/test_physics.py).
    """
    model = system.compile()
    data, rows, right = mujoco.MjData(model), [], []
    for qpos in np.random.default_rng(0).uniform(-3, 3, (POSES, model.nq)):
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        inertia, jacobian = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        own = []
        for mark in system.landmarks:
            body = model.body(mark.body).id
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ np.asarray(mark.mass_position)
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            own.append((jacobian.T @ jacobian).ravel())
        rows.append(np.stack(own, axis=1))
        right.append(inertia.ravel())
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0].tolist()
