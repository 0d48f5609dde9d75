"""Draws joint recordings: what a camera of the simulator would have seen of a motion that was measured elsewhere."""

import math
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.disturbance import Disturbance, seen
from keycld_envs.errors import InputError
from keycld_envs.projection import pose
from keycld_envs.recordings.checks import check_units
from keycld_envs.recordings.recording import Recording
from keycld_envs.rendering import Quality, Renderer, describe_camera

FURTHEST = 0.5
"""Frame times that a measured sample may be away from the time of a frame; beyond, the frame is left out."""


def rerender(
    recording: Recording,
    model: mujoco.MjModel,
    camera: str,
    *,
    size: tuple[int, int] = (64, 64),
    rate: float = 50.0,
    quality: Quality = "fast",
    disturbance: Disturbance | None = None,
    seed: int = 0,
    advance: Callable[[], None] = lambda: None,
) -> Recording:
    """The same recording with frames of a simulated camera, drawn at measured joint positions.

    Every frame is drawn at a measured sample, at whose time it stands, so that nothing is interpolated: of all samples
    the one next to each time of the frame rate. The camera sees the mechanism as the encoders did, with their noise.

    Args:
        recording: with joint positions.
        model: the simulator, with joints of the same names.
        camera: its name in the model.
        size: width and height of frames, pixels.
        rate: frames per second, at most.
        quality: of shadows and edges.
        disturbance: what the camera does to images.
        seed: of the disturbance's noise.
        advance: is called after every frame.

    Raises:
        InputError: if there are no joint positions, none of all joints at once, or not of the model's joints, or in
            other units.
    """
    positions = _positions(recording, model)
    samples = _samples(recording, positions, rate)
    data, frames = mujoco.MjData(model), np.empty((len(samples), size[1], size[0], 3), np.uint8)
    renderer = Renderer(model, *size, quality)
    try:
        for frame, (index, sample) in zip(frames, enumerate(samples), strict=True):
            pose(model, data, positions[sample])
            frame[:] = seen(disturbance, renderer, data, camera, (seed, index))
            advance()
    finally:
        renderer.close()
    return replace(
        recording,
        source="rerendered",
        camera=describe_camera(model, data, camera, *size),
        render_quality=quality,
        t_frame=np.asarray(recording.t_state)[samples],
        frames=frames,
        video=None,
        keypoints=None,
        keypoint_covariance=None,
        pivot=None,
        notes=f"{recording.notes} Frames are drawn at the joint positions.".strip(),
    )


def count_frames(recording: Recording, model: mujoco.MjModel, rate: float) -> int:
    """How many frames `rerender` draws; it raises what that raises."""
    return len(_samples(recording, _positions(recording, model), rate))


def _positions(recording: Recording, model: mujoco.MjModel) -> NDArray[np.float64]:
    """`[Ts, nq]` in the order of the model."""
    own = [model.joint(j).name for j in range(model.njnt)]
    if recording.qpos is None or recording.t_state is None:
        raise InputError(f"Recording {recording.id!r} has no joint positions (qpos); there is nothing to draw.")
    if sorted(own) != sorted(recording.joint_names) or model.nq != len(own):
        raise InputError(
            f"Recording {recording.id!r} has the joints {', '.join(recording.joint_names)}, the simulator has "
            f"{', '.join(own)}; hinges and slides of the same names are needed."
        )
    check_units(recording)
    return np.asarray(recording.qpos)[:, [recording.joint_names.index(name) for name in own]]


def _samples(recording: Recording, positions: NDArray[np.float64], rate: float) -> NDArray[np.intp]:
    """Of each frame, the measured sample next to it."""
    measured = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if not len(measured):
        raise InputError(f"Recording {recording.id!r} has no sample at which all joints were measured; leave it out.")
    clock = np.asarray(recording.t_state)[measured]
    asked = clock[0] + np.arange(math.floor((clock[-1] - clock[0]) * rate + 1e-6) + 1) / rate
    after = np.searchsorted(clock, asked).clip(0, len(clock) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(asked - clock[before] <= clock[after] - asked, before, after)
    return measured[np.unique(nearest[np.abs(clock[nearest] - asked) <= FURTHEST / rate])]
