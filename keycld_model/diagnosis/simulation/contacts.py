"""Contacts that the recordings do not have: models that cannot collide are stepped exactly, and fast."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.inputs.observation import Observation
from keycld_model.rigid_body.tree import may_collide


def without_contacts(
    model: mujoco.MjModel, recordings: Sequence[Recording], observation: Observation
) -> mujoco.MjModel:
    """The model with geometry that does not collide, if nothing touches in any recorded pose; else the model itself."""
    if not may_collide(model) or model.npair:
        return model
    data = mujoco.MjData(model)
    for recording in recordings:
        q = observation.positions(observation.measured(recording))
        q = q[np.isfinite(q).all(axis=1)]
        for pose in q[:: max(1, len(q) // 2000)]:  # so many poses tell
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                return model
    free = copy.copy(model)
    free.geom_contype[:], free.geom_conaffinity[:] = 0, 0
    return free
