"""Refuses recordings from which nothing can be learned."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.inputs.observation import Observation
from keycld_model.diagnosis.inputs.source import unnamed

SLOWEST = 0.5
"""Seconds between samples: a motion that is seen less often cannot be followed."""


def check(recordings: Sequence[Recording], model: mujoco.MjModel, observation: Observation, samples: int) -> None:
    """Raise InputError with the recording and the remedy if recordings do not suit a model.

    Args:
        recordings: all of them.
        model: the simulator.
        observation: what is measured.
        samples: that each recording must have.
    """
    if not recordings:
        raise InputError("There are no recordings; hand in at least one with joint positions.")
    check_model(model)
    check_commands(recordings, model)
    for recording in recordings:
        observation.check(recording)
        _check_clocks(recording, f"Recording {recording.id!r}", samples)
    shown = [observation.measured(recording) for recording in recordings]
    moved = np.nanmax([np.nanmax(y, axis=0) - np.nanmin(y, axis=0) for y in shown], axis=0)
    if moved.max() < 0.05:
        most = int(moved.argmax())
        raise InputError(
            f"{observation.names[most]!r} moved {moved[most]:.2g} {observation.units[most]} at most, and nothing else "
            "moved more; nothing can be identified. Excite the mechanism."
        )


def check_model(model: mujoco.MjModel) -> None:
    """Raise InputError if a simulator has joints that are not handled, or parts that nothing can be said of."""
    if not np.isin(model.jnt_type, [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]).all():
        raise InputError("The model has a ball or free joint; diagnosis handles hinges and slides.")
    if (nameless := unnamed(model)) is not None:
        raise InputError(
            f"The simulator's {nameless} has no name; name it in the MJCF, or hand in Source.of_file(path).model, in "
            "which everything has one."
        )


def check_commands(recordings: Sequence[Recording], model: mujoco.MjModel) -> None:
    """Raise InputError if recordings have other commands than those of a simulator's motors."""
    for recording in recordings:
        who = f"Recording {recording.id!r}"
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


def check_films(recordings: Sequence[Recording], samples: int) -> None:
    """Raise InputError if the clocks of frames cannot be those of a motion, before any is looked at."""
    for recording in recordings:
        if recording.t_frame is not None:
            _check_clock(np.asarray(recording.t_frame), "frame", f"Recording {recording.id!r}", samples)


def _check_clock(t: NDArray[np.float64], what: str, who: str, samples: int) -> None:
    """Of samples or frames."""
    clock = {"sample": "t_state", "frame": "t_frame"}[what]
    if len(t) < samples:
        raise InputError(f"{who} has {len(t)} {what}s; at least {samples} are needed.")
    between = float(np.median(np.diff(t)))
    if not between > 0:
        raise InputError(f"{who} has a clock that stands still ({clock}); record when each {what} was taken.")
    if between > SLOWEST:
        raise InputError(
            f"{who} has a {what} every {between:.3g} s; {clock} must be in seconds, {SLOWEST} s apart at most."
        )


def _check_clocks(recording: Recording, who: str, samples: int) -> None:
    t, t_action = np.asarray(recording.t_state), recording.t_action
    _check_clock(t, "sample", who, samples)
    if recording.action is None or t_action is None or not len(t_action):
        return
    if t_action[0] >= t[-1] or (len(t_action) > 1 and t_action[-1] <= t[0]):
        raise InputError(
            f"{who} has commands from {t_action[0]:g} to {t_action[-1]:g} s and positions from {t[0]:g} to {t[-1]:g} s"
            "; t_action and t_state must count from the same time."
        )


def check_apart(training: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Raise InputError if a recording is in both."""
    for a in training:
        for b in held_out:
            if a.qpos is not None and b.qpos is not None and np.array_equal(a.qpos, b.qpos, equal_nan=True):
                raise InputError(
                    f"The held-out recording {b.id!r} equals the training recording {a.id!r}; hold out other motions."
                )
