"""A recording on one clock, as formats need it in which a step has an observation and an action."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings.recording import Recording
from keycld_envs.recordings.storage import META

Array = NDArray[np.float64]
ON_TIME = 1e-4
"""Part of a step within which two clocks are the same."""


@dataclass(frozen=True, eq=False)
class Rows:
    """A recording on the clock of its frames or, without any, of its joints.

    Attributes:
        recording: which one.
        clock: [T], s.
        qpos: [T, nq], rad or m, or None.
        qvel: [T, nq], rad/s or m/s, or None.
        action: [T - 1, nu], held from one time of the clock to the next.
        lost: what became of the recording, a sentence each.
    """

    recording: Recording
    clock: Array
    qpos: Array | None
    qvel: Array | None
    action: Array
    lost: tuple[str, ...]

    def frames(self) -> Iterator[NDArray[np.uint8]]:
        """Each [H, W, 3]."""
        return self.recording.iter_frames()


def on_one_clock(recording: Recording, clock: Array | None = None) -> Rows:
    """Bring a recording to one clock: positions and velocities linearly, actions by their means.

    Args:
        recording: which one.
        clock: [T], s, within the recording's time; by default that of its frames or joints.

    Raises:
        InputError: if the recording has fewer than two samples, or its actions begin after the clock.
    """
    if clock is None:
        clock = recording.t_state if recording.t_frame is None else recording.t_frame
    if clock is None or len(clock) < 2:
        raise InputError(f"Recording {recording.id!r} has fewer than two samples; leave it out.")
    lost = []
    qpos, qvel, action = recording.qpos, recording.qvel, recording.action
    if recording.t_state is not None and not _same(recording.t_state, clock):
        qpos, qvel = _between(clock, recording.t_state, qpos), _between(clock, recording.t_state, qvel)
        lost.append("joint positions are interpolated linearly to the clock of the rows")
    if action is None or recording.t_action is None:
        action = np.zeros((len(clock) - 1, 0))
    elif len(action) == len(clock) and _same(recording.t_action, clock):
        action = action[:-1]
        lost.append("the action at the last sample, which nothing recorded comes after, is left out")
    elif not _same(recording.t_action, clock[:-1]):
        action = recording.mean_actions(clock)
        lost.append("actions are averaged over each interval between two rows")
    left_out = [
        name
        for name in ("qpos_std", "keypoints", "keypoint_covariance", "pivot")
        if getattr(recording, name) is not None
    ]
    if left_out:
        lost.append(f"{', '.join(left_out)} are left out")
    return Rows(recording, clock, qpos, qvel, action, tuple(lost))


def about(recording: Recording) -> dict[str, Any]:
    """The fields of a recording that are no arrays, as JSON has them."""
    return {name: getattr(recording, name) for name in META}


def check_alike(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that do not fit in one data set: with other joints, actuators, signals, or sizes of frames.

    Raises:
        InputError: if one differs from the first.
    """
    first = recordings[0]
    for recording in recordings[1:]:
        for what, a, b in (
            ("joints", first.joint_names, recording.joint_names),
            ("actuators", first.actuator_names, recording.actuator_names),
            ("units", dict(first.units), dict(recording.units)),
            ("frames", first.num_frames > 0, recording.num_frames > 0),
            ("joint velocities", first.qvel is not None, recording.qvel is not None),
        ):
            if a != b:
                raise InputError(
                    f"Recording {recording.id!r} has other {what} than {first.id!r} ({b} and {a}); export them apart."
                )


def _same(a: Array, b: Array) -> bool:
    """Whether two clocks are one."""
    return len(a) == len(b) and bool(np.abs(a - b).max(initial=0.0) <= ON_TIME * np.median(np.diff(b)))


def _between(clock: Array, times: Array, values: Array | None) -> Array | None:
    if values is None:
        return None
    return np.stack([np.interp(clock, times, v, left=np.nan, right=np.nan) for v in values.T], axis=1)
