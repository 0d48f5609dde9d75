"""One recording: what was commanded, measured and seen, each on its own raw clock."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings.validation import problem
from keycld_envs.recordings.video import iter_video

Source = Literal["simulation", "real", "rerendered"]


class InvalidRecording(InputError):
    """A recording with a wrong field or array.

    Attributes:
        id: id of the recording.
        problem: "FILE: sentence.", the file being the one the field or array is stored in.
    """

    def __init__(self, id: str, problem: str) -> None:
        super().__init__(id, problem)
        self.id, self.problem = id, problem

    def __str__(self) -> str:
        return f"Recording {self.id!r}, {self.problem}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """One run of a system in the format `keycld.recording/1`; every instance is valid.

    Clocks are raw: their rates may differ, jitter and gaps stay, they never run backwards. NaN marks a
    missing sample of `qpos` or `qvel`. An action is a command and holds until the next, so it is never NaN.

    Attributes:
        id: name of the recording, unique in its data set.
        system: environment id ("KeyCLD/Acrobot-v0"), or None for a system without an environment.
        source: "simulation", "real", or "rerendered" (real joint data, synthetic pixels).
        joint_names: one name per column of `qpos` and `qvel`.
        actuator_names: one name per column of `action`.
        units: unit of each stored signal ("action", "qpos", "qvel"); one string for all columns, or one each.
        camera: None, or at least "width" and "height" in pixels, and how world metres map to image units.
        render_quality: quality the frames were rendered with, None for a camera.
        seed: seed the run was drawn from, None for a real system.
        licence: licence of the data.
        origin: where the data come from.
        notes: anything else worth knowing.
        t_action: [Ta], seconds.
        action: [Ta, nu]; action i holds from t_action[i] until t_action[i+1], the last one until the end.
        t_state: [Ts], seconds.
        qpos: [Ts, nq], measured joint positions, rad or m, angles unwrapped.
        qpos_std: [Ts, nq], standard deviations of `qpos`, only if known.
        qvel: [Ts, nq], measured joint velocities, only if measured.
        t_frame: [Tf], seconds.
        frames: [Tf, H, W, 3] uint8, None when `video` holds the frames.
        keypoints: [Tf, K, 2], column and row of keypoints in the frames, pixels; NaN where they were not found.
        keypoint_covariance: [Tf, K, 2, 2], their covariances, pixels².
        pivot: [Tf, 2], column and row of the fixed pivot, which may lie outside the picture, pixels.
        video: a file whose frames belong to `t_frame`: FFV1 or a camera's own file; it is decoded on demand.
    """

    id: str
    source: Source
    system: str | None = None
    joint_names: tuple[str, ...] = ()
    actuator_names: tuple[str, ...] = ()
    units: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    camera: Mapping[str, Any] | None = None
    render_quality: str | None = None
    seed: int | None = None
    licence: str = ""
    origin: str = ""
    notes: str = ""
    t_action: NDArray[np.float64] | None = None
    action: NDArray[np.float64] | None = None
    t_state: NDArray[np.float64] | None = None
    qpos: NDArray[np.float64] | None = None
    qpos_std: NDArray[np.float64] | None = None
    qvel: NDArray[np.float64] | None = None
    t_frame: NDArray[np.float64] | None = None
    keypoints: NDArray[np.float64] | None = None
    keypoint_covariance: NDArray[np.float64] | None = None
    pivot: NDArray[np.float64] | None = None
    frames: NDArray[np.uint8] | None = None
    video: Path | None = None

    def __post_init__(self) -> None:
        """Check everything but the inside of a video, which `iter_frames` checks as it decodes.

        Raises:
            InvalidRecording: if a field or array is wrong; the message names the key, shape and index.
        """
        if message := problem(self):
            raise InvalidRecording(self.id, message)

    @property
    def num_frames(self) -> int:
        """Tf, zero for a recording without frames."""
        return 0 if self.t_frame is None else len(self.t_frame)

    def iter_frames(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames, [H, W, 3] uint8, one at a time.

        Raises:
            InputError: if the video is damaged or its number of frames differs from the length of `t_frame`.
        """
        if self.video is not None:
            yield from iter_video(self.video, self.num_frames)
        elif self.frames is not None:
            yield from self.frames

    def load_frames(self) -> NDArray[np.uint8]:
        """All frames in memory, [Tf, H, W, 3] uint8.

        Raises:
            InputError: if there are none, or the video is damaged.
        """
        if self.frames is not None:
            return self.frames
        if self.video is None:
            raise InputError(f"Recording {self.id!r} has no frames; render or film it first.")
        return np.stack(list(self.iter_frames()))

    def mean_actions(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """The mean of the held action over each interval between two `times`.

        On a common clock this is the recorded action itself; on any other it has the same impulse.

        Args:
            times: [T] strictly increasing, seconds.

        Returns:
            [T-1, nu]; nu is 0 for a recording without actions.

        Raises:
            InputError: if the first action comes after the first of `times`.
        """
        if self.action is None or self.t_action is None or not self.action.shape[1]:
            return np.zeros((len(times) - 1, 0))
        if times[0] < self.t_action[0] - 1e-9:
            raise InputError(
                f"Recording {self.id!r}, signals.npz: t_action starts at {self.t_action[0]:g} s, after the first "
                f"frame at {times[0]:g} s; cut the frames or record the action from the start."
            )
        clock = np.append(self.t_action, max(times[-1], self.t_action[-1]))
        impulse = np.cumsum(np.diff(clock)[:, None] * self.action, axis=0)
        impulse = np.concatenate([np.zeros((1, self.action.shape[1])), impulse])
        at_times = np.stack([np.interp(times, clock, column) for column in impulse.T], axis=1)
        return np.diff(at_times, axis=0) / np.diff(times)[:, None]

    def positions_at(self, times: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Joint positions at `times`, linear between samples.

        Args:
            times: [T], seconds.

        Returns:
            [T, nq], NaN beside a missing sample and outside the measured time; None if qpos was not recorded.
        """
        if self.qpos is None or self.t_state is None:
            return None
        return np.stack(
            [np.interp(times, self.t_state, column, left=np.nan, right=np.nan) for column in self.qpos.T], axis=1
        )
