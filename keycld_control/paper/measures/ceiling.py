"""For how long the true mechanism agrees with its own recordings.

They come from a simulator whose steps are coarse for fast rods. A pole at a hundred radians per second turns by one in
a step, and what the simulator then loses adds up to the deviation that counts as wrong, however well physics is known.
"""

import mujoco
import numpy as np

from keycld_control.paper.measures.angles import WRONG
from keycld_control.paper.measures.plant import simulator
from keycld_envs import get_system
from keycld_envs.recordings.dataset import Sequences
from keycld_model.evaluation import valid_frames
from keycld_model.evaluation.joint_coordinates import wrap

FINER = 10


def ceiling(system: str, truth: Sequences, finer: int = FINER) -> list[float]:
    """Valid fractions of the angles of the true plant, from the first pose, at rest, in steps that are `finer`.

    A model that fits its start to several frames may do better: where the simulator takes semi-implicit Euler steps,
    these run ahead by half a step's acceleration, which under a constant action looks like a velocity at the start.
    """
    assert truth.qpos is not None
    plant, substeps = simulator(system, finer)
    hinges = [joint.kind == "hinge" for joint in get_system(system).joints]
    data, errors = mujoco.MjData(plant), np.zeros((len(truth.qpos), truth.qpos.shape[1]))
    for n, (qpos, actions) in enumerate(zip(truth.qpos, truth.actions, strict=True)):
        mujoco.mj_resetData(plant, data)
        data.qpos[:] = qpos[0]
        for t, action in enumerate(actions, 1):
            data.ctrl[:] = action
            mujoco.mj_step(plant, data, substeps)
            errors[n, t] = np.abs(wrap(data.qpos - qpos[t])[hinges]).max()
    return (valid_frames(errors, WRONG) / errors.shape[1]).tolist()
