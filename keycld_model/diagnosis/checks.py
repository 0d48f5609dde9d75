"""Refuses recordings from which nothing can be learned."""

from collections.abc import Sequence

import mujoco
import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.source import unnamed

LEAST_MOTION = 0.05
"""Rad or m that at least one joint must move."""
LEAST_SAMPLES = 40


def check(recordings: Sequence[Recording], model: mujoco.MjModel) -> None:
    """Raise InputError with the recording and the remedy if the recordings do not suit the model."""
    if not recordings:
        raise InputError("There are no recordings; hand in at least one with joint positions.")
    if not np.isin(model.jnt_type, [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]).all():
        raise InputError("The model has a ball or free joint; diagnosis handles hinges and slides.")
    if (nameless := unnamed(model)) is not None:
        raise InputError(
            f"The simulator's {nameless} has no name; name it in the MJCF, or hand in Source.of_file(path).model, in "
            "which everything has one."
        )
    joints = tuple(model.joint(j).name for j in range(model.njnt))
    for recording in recordings:
        who = f"Recording {recording.id!r}"
        if recording.qpos is None or recording.t_state is None:
            raise InputError(f"{who} has no joint positions; record qpos and t_state.")
        if tuple(recording.joint_names) != joints:
            raise InputError(
                f"{who} has the joints {list(recording.joint_names)}, the simulator has {list(joints)}; name and order "
                "the columns of qpos like the simulator's joints."
            )
        if recording.action is not None and recording.action.shape[1] != model.nu:
            raise InputError(
                f"{who} has {recording.action.shape[1]} actions {list(recording.actuator_names)}, the simulator has "
                f"{model.nu} actuators {[model.actuator(i).name for i in range(model.nu)]}; record the commands of all."
            )
        if len(recording.t_state) < LEAST_SAMPLES:
            raise InputError(f"{who} has {len(recording.t_state)} samples; at least {LEAST_SAMPLES} are needed.")
        if np.isfinite(recording.qpos).mean() < 0.5:
            raise InputError(f"{who} misses more than half of its samples (NaN in qpos); leave it out.")
    moved = np.max(
        [np.ptp(q[np.isfinite(q).all(axis=1)], axis=0) for q in (np.asarray(r.qpos) for r in recordings)], axis=0
    )
    if moved.max() < LEAST_MOTION:
        name = joints[int(moved.argmax())]
        raise InputError(
            f"The joint {name!r} moved {moved.max():.2g} rad or m at most, and no other moved more; nothing can be "
            "identified. Excite the mechanism."
        )


def check_apart(training: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Raise InputError if a recording is in both."""
    for a in training:
        for b in held_out:
            if a.qpos is not None and b.qpos is not None and np.array_equal(a.qpos, b.qpos, equal_nan=True):
                raise InputError(
                    f"The held-out recording {b.id!r} equals the training recording {a.id!r}; hold out other motions."
                )
