"""Refuses recordings whose joint positions are not what the simulator's are."""

import mujoco
import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_envs.recordings.checks import check_units

FEWEST = 4
"""Samples of a joint's position."""
PAUSE = 3.0
"""Usual intervals between samples; in a longer one a hinge may turn far."""


def check_positions(recording: Recording, model: mujoco.MjModel) -> None:
    """Raise InputError if a recording does not have positions of a model's joints, usable as they are."""
    who, joints = f"Recording {recording.id!r}", tuple(model.joint(j).name for j in range(model.njnt))
    if recording.qpos is None or recording.t_state is None:
        raise InputError(f"{who} has no joint positions; record qpos and t_state.")
    if tuple(recording.joint_names) != joints:
        raise InputError(
            f"{who} has the joints {list(recording.joint_names)}, the simulator has {list(joints)}; name and order "
            "the columns of qpos like the simulator's joints."
        )
    check_units(recording)
    positions = np.asarray(recording.qpos)
    first = int(np.isfinite(positions).any(axis=1).argmax())
    for j, name in enumerate(recording.joint_names):
        q = positions[first:, j]
        good = np.flatnonzero(np.isfinite(q))
        if len(q) < FEWEST:
            raise InputError(f"{who} has {len(q)} samples; a motion needs at least {FEWEST}, so record for longer.")
        if len(good) < max(FEWEST, len(q) / 2):
            raise InputError(f"{who} misses more than half of the samples of {name!r} (NaN in qpos); leave it out.")
        steps = np.diff(np.asarray(recording.t_state)[first:])
        near = (np.diff(good) == 1) & (steps[good[:-1]] < PAUSE * np.median(steps))
        jumps = np.abs(np.diff(q[good]))[near]
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE and np.any((jumps > 5.0) & (jumps < 7.5)):
            raise InputError(
                f"{who} has angles of {name!r} that jump by {jumps.max():.3g} rad from one sample to the next; unwrap "
                "qpos (numpy.unwrap), or convert it if it is in degrees."
            )
