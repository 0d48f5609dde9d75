"""What makes a recording valid, and the sentence that says what is wrong when it is not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from keycld_envs.recordings.recording import Recording

SIGNALS = (
    "t_action",
    "action",
    "t_state",
    "qpos",
    "qvel",
    "t_frame",
    "qpos_std",
    "keypoints",
    "keypoint_covariance",
    "pivot",
)
DIMENSIONS = {"keypoints": 3, "keypoint_covariance": 4}
"""Dimensions of arrays that are not [T, n]; clocks have one."""
SOURCES = ("simulation", "real", "rerendered")


def problem(recording: Recording) -> str | None:
    """The first thing wrong with a recording, as "FILE: sentence.", or None if it is valid."""
    for file, checks in (("meta.json", _meta), ("signals.npz", _signals), ("frames.npz", _frames)):
        for message in checks(recording):
            return f"{file}: {message}"
    return None


def _meta(recording: Recording) -> Iterator[str]:
    for name, kind in (("id", str), ("licence", str), ("origin", str), ("notes", str)):
        if not isinstance(getattr(recording, name), kind):
            yield f"{name} is {getattr(recording, name)!r}; it must be a string."
    if not recording.id:
        yield "id is empty; give the recording a name."
    elif any(c in recording.id for c in "/\\\0") or recording.id.startswith("."):
        yield f"id is {recording.id!r}; it names a folder: leave out slashes, and a dot in front."
    for name in ("system", "render_quality"):
        if not isinstance(getattr(recording, name), str | None):
            yield f"{name} is {getattr(recording, name)!r}; it must be a string or null."
    if recording.system == "":
        yield "system is empty; name an environment, or write null."
    if isinstance(recording.seed, bool) or not isinstance(recording.seed, int | None):
        yield f"seed is {recording.seed!r}; it must be an integer or null."
    if recording.source not in SOURCES:
        yield f"source is {recording.source!r}; it must be one of {', '.join(SOURCES)}."
    for name in ("joint_names", "actuator_names"):
        names = getattr(recording, name)
        if not isinstance(names, tuple) or not all(isinstance(n, str) for n in names):
            yield f"{name} is {names!r}; it must be a list of strings."
        elif len(set(names)) < len(names):
            yield f"{name} {list(names)} has the same name twice; name each once."
    if not isinstance(recording.units, Mapping):
        yield f"units is {recording.units!r}; it must map each signal to its unit."
    if recording.camera is not None:
        if not isinstance(recording.camera, Mapping):
            yield f"camera is {recording.camera!r}; it must be null or an object with width and height."
        else:
            for side in ("width", "height"):
                if not isinstance(recording.camera.get(side), int):
                    yield f"camera.{side} is {recording.camera.get(side)!r}; it must be a number of pixels."


def _signals(recording: Recording) -> Iterator[str]:
    if recording.t_frame is None and recording.qpos is None and recording.frames is None and recording.video is None:
        yield "there are neither frames nor qpos; a recording needs one of them."
    for key in SIGNALS:
        array = getattr(recording, key)
        dimensions = 1 if key.startswith("t_") else DIMENSIONS.get(key, 2)
        if array is None:
            continue
        if not isinstance(array, np.ndarray) or array.dtype != np.float64:
            yield f"{key} is {getattr(array, 'dtype', type(array).__name__)}; it must be a float64 array."
        if array.ndim != dimensions:
            yield f"{key} has shape {list(array.shape)}; it must have {dimensions} dimension(s)."
        if len(array) == 0:
            yield f"{key} is empty; leave it out or fill it."
        if message := _bad_value(key, array):
            yield message
    for clock, key, names in (
        ("t_action", "action", "actuator_names"),
        ("t_state", "qpos", "joint_names"),
        ("t_state", "qvel", "joint_names"),
    ):
        yield from _signal_on_clock(recording, clock, key, names)
    yield from _tracked(recording)
    if recording.t_action is not None and recording.action is None:
        yield "t_action stands without action; store both or neither."
    if recording.t_state is not None and recording.qpos is None and recording.qvel is None:
        yield "t_state stands without qpos or qvel; store them or leave it out."


def _tracked(recording: Recording) -> Iterator[str]:
    """What is wrong with the shapes of keypoints, of their covariances, and of standard deviations of positions."""
    frames = recording.num_frames
    keypoints = 0 if recording.keypoints is None else recording.keypoints.shape[1]
    for key, rest in (("keypoints", (keypoints, 2)), ("keypoint_covariance", (keypoints, 2, 2)), ("pivot", (2,))):
        array = getattr(recording, key)
        if array is not None and array.shape != (frames, *rest):
            yield f"{key} has shape {list(array.shape)}; it must be {[frames, *rest]}, one row for each frame."
    if recording.qpos_std is not None and (recording.qpos is None or recording.qpos.shape != recording.qpos_std.shape):
        yield f"qpos_std has shape {list(recording.qpos_std.shape)}; it must have that of qpos."
    if recording.qpos_std is not None and len(low := np.argwhere(recording.qpos_std < 0)):
        index = ", ".join(map(str, low[0]))
        yield f"qpos_std[{index}] is {recording.qpos_std[tuple(low[0])]:g}; a standard deviation is not negative."


def _signal_on_clock(recording: Recording, clock: str, key: str, names: str) -> Iterator[str]:
    array, times = getattr(recording, key), getattr(recording, clock)
    if array is None:
        return
    if times is None:
        yield f"{key} has no clock; store {clock}, the time of each row in seconds."
    elif len(array) != len(times):
        yield f"{key} has {len(array)} rows, but {clock} has {len(times)}; every row needs its time."
    columns = array.shape[1]
    if columns != len(getattr(recording, names)):
        yield (
            f"{key} has {columns} columns, but meta.json names {len(getattr(recording, names))} {names}; "
            "name each column once."
        )
    unit = recording.units.get(key)
    if isinstance(unit, tuple) and all(isinstance(u, str) for u in unit):
        if len(unit) != columns:
            yield f"{key} has {columns} columns, but units.{key} in meta.json has {len(unit)}; state one for each."
    elif not isinstance(unit, str):
        yield f"{key} has no unit; state units.{key} in meta.json, one for all columns or one each."


def _bad_value(key: str, array: np.ndarray) -> str | None:
    """What is wrong with the numbers of one signal: infinities, NaN where it may not be, a clock going back."""
    may_miss = key in ("qpos", "qpos_std", "qvel", "keypoints", "keypoint_covariance", "pivot")
    wrong = np.argwhere(np.isinf(array) if may_miss else ~np.isfinite(array))
    if len(wrong):
        index = ", ".join(map(str, wrong[0]))
        remedy = (
            "mark a missing sample with NaN"
            if may_miss
            else "an action is a command and cannot be missing: repeat the one that was held"
            if key == "action"
            else "every row needs a time"
        )
        return f"{key}[{index}] is {array[tuple(wrong[0])]}; {remedy}."
    if key.startswith("t_") and len(back := np.flatnonzero(np.diff(array) < 0)):
        i = back[0] + 1
        return (
            f"{key}[{i}] = {array[i]:g} s comes after {array[i - 1]:g} s; "
            "clocks never run backwards, sort the rows by time."
        )
    return None


def _frames(recording: Recording) -> Iterator[str]:
    frames: Any = recording.frames
    if frames is not None and recording.video is not None:
        yield "frames are stored twice, as an array and as a video; keep one."
    if recording.t_frame is None:
        if frames is not None or recording.video is not None:
            yield "frames have no clock; store t_frame, the time of each frame in seconds, in signals.npz."
        return
    if frames is None:
        if recording.video is None:
            yield f"t_frame lists {len(recording.t_frame)} frames, but no frames are stored; add them."
        return
    if not isinstance(frames, np.ndarray) or frames.dtype != np.uint8:
        yield f"frames is {getattr(frames, 'dtype', type(frames).__name__)}; it must be a uint8 array."
    if frames.ndim != 4 or frames.shape[3] != 3 or 0 in frames.shape:
        yield f"frames has shape {list(frames.shape)}; it must be [T, H, W, 3]."
    if len(frames) != len(recording.t_frame):
        yield f"frames has {len(frames)} frames, but t_frame has {len(recording.t_frame)}; every frame needs its time."
    if recording.camera is not None:
        size = (recording.camera["height"], recording.camera["width"])
        if frames.shape[1:3] != size:
            yield (
                f"frames is {frames.shape[2]}×{frames.shape[1]} pixels, but camera in meta.json says "
                f"{size[1]}×{size[0]}; correct one of them."
            )
