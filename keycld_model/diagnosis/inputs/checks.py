"""Refuses recordings from which nothing can be learned."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.inputs.prepare import SAMPLES
from keycld_model.diagnosis.inputs.source import unnamed
from keycld_model.diagnosis.inputs.windows import first_seen

LEAST_MOTION = 0.05
"""Rad or m that at least one joint must move."""
SLOWEST = 0.5
"""Seconds between samples, at most."""
WRAPPED = (5.0, 7.5)
"""Rad between two samples of a hinge that look like a turn that was left out."""
DONE = ("rad", "m", "1", "")
"""Units of positions that need no conversion."""


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
        names = {model.actuator(i).name: i for i in range(model.nu)}
        order = [names[name] for name in recording.actuator_names if name in names]
        if recording.action is not None and len(order) == model.nu and order != sorted(order):
            raise InputError(
                f"{who} has the actions {list(recording.actuator_names)}, the simulator has the actuators {list(names)}"
                "; order the columns of action like the simulator's actuators."
            )
        _check_clocks(recording, who)
        _check_positions(recording, model, who)
    moved = np.nanmax([np.nanmax(q, axis=0) - np.nanmin(q, axis=0) for q in map(_seen, recordings)], axis=0)
    if moved.max() < LEAST_MOTION:
        name = joints[int(moved.argmax())]
        raise InputError(
            f"The joint {name!r} moved {moved.max():.2g} rad or m at most, and no other moved more; nothing can be "
            "identified. Excite the mechanism."
        )


def _seen(recording: Recording) -> NDArray[np.float64]:
    """Positions from the first that is there."""
    q = np.asarray(recording.qpos)
    return q[first_seen(q) :]


def _check_clocks(recording: Recording, who: str) -> None:
    t, t_action = np.asarray(recording.t_state), recording.t_action
    if len(t) < SAMPLES:
        raise InputError(f"{who} has {len(t)} samples; at least {SAMPLES} are needed.")
    between = float(np.median(np.diff(t)))
    if not between > 0:
        raise InputError(f"{who} has a clock that stands still (t_state); record when each sample was taken.")
    if between > SLOWEST:
        raise InputError(
            f"{who} has a sample every {between:.3g} s; t_state must be in seconds, {SLOWEST} s apart at most."
        )
    if recording.action is None or t_action is None or not len(t_action):
        return
    if t_action[0] >= t[-1] or (len(t_action) > 1 and t_action[-1] <= t[0]):
        raise InputError(
            f"{who} has commands from {t_action[0]:g} to {t_action[-1]:g} s and positions from {t[0]:g} to {t[-1]:g} s"
            "; t_action and t_state must count from the same time."
        )


def _check_positions(recording: Recording, model: mujoco.MjModel, who: str) -> None:
    unit = recording.units.get("qpos", "")
    for j, name in enumerate(recording.joint_names):
        own = unit if isinstance(unit, str) else unit[j]
        if own not in DONE:
            raise InputError(f"{who} has positions of {name!r} in {own!r}; convert qpos to rad or m.")
        q = _seen(recording)[:, j]
        good = np.flatnonzero(np.isfinite(q))
        if len(good) < max(4, len(q) / 2):
            raise InputError(f"{who} misses more than half of the samples of {name!r} (NaN in qpos); leave it out.")
        jumps = np.abs(np.diff(q[good]))[np.diff(good) == 1]
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE and np.any((jumps > WRAPPED[0]) & (jumps < WRAPPED[1])):
            raise InputError(
                f"{who} has angles of {name!r} that jump by {jumps.max():.3g} rad from one sample to the next; unwrap "
                "qpos (numpy.unwrap)."
            )


def check_apart(training: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Raise InputError if a recording is in both."""
    for a in training:
        for b in held_out:
            if a.qpos is not None and b.qpos is not None and np.array_equal(a.qpos, b.qpos, equal_nan=True):
                raise InputError(
                    f"The held-out recording {b.id!r} equals the training recording {a.id!r}; hold out other motions."
                )
