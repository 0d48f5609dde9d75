"""Frames of what a camera saw, with the links as they were read off and as simulators have them."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.projection import focal_length, world_to_image
from keycld_envs.recordings import Recording
from keycld_envs.recordings.crop import reduced
from keycld_model.diagnosis.inputs.prepare import LAST_THIRD
from keycld_model.diagnosis.output.page.geometry import Skeleton, skeleton
from keycld_model.diagnosis.verdict.evidence import Picture, Rollout
from keycld_model.image_alignment import Positions
from keycld_model.image_alignment.films import LARGEST
from keycld_model.image_alignment.look import as_seen, pixels_of

Array = NDArray[np.float64]
MOST = 500
"""Frames that are shown, 10 s of most cameras."""


def pictures(
    rollouts: Sequence[Rollout], recordings: Sequence[Recording], positions: Positions, model: mujoco.MjModel
) -> tuple[Picture, ...]:
    """Frames of the recording in which the refitted simulator is farthest off, about then, or the first frames.

    Args:
        rollouts: of recordings held out; none if nothing was tested.
        recordings: all, with frames.
        positions: that were read off them.
        model: the simulator.
    """
    if rollouts:
        chosen = max(rollouts, key=lambda r: float(np.nanmax(np.abs(r.poses[1] - r.poses[0]), initial=0.0)))
        times, poses = chosen.time, chosen.poses
        name = chosen.recording
    else:
        read = positions.recordings[0]
        name, times = read.id, np.asarray(read.t_state)
        poses = np.full((3, len(times), model.nq), np.nan)
        poses[0] = np.asarray(read.qpos)
    whole = {recording.id + part: recording for recording in recordings for part in ("", LAST_THIRD)}
    recording = whole[name]
    off = np.abs(poses[1] - poses[0]).max(1)
    worst = times[int(np.nanargmax(off))] if np.isfinite(off).any() else times[0]
    clock = np.asarray(recording.t_frame)
    there = np.flatnonzero((clock >= times[0]) & (clock <= times[-1]))
    first = int(np.clip(np.searchsorted(clock[there], worst) - MOST // 2, 0, max(0, len(there) - MOST)))
    shown = there[first : first + MOST]
    near = [int(np.abs(times - clock[n]).argmin()) for n in shown]
    drawn = skeleton(as_seen(model, positions.parameters, positions.values))
    links = dict(zip(shown.tolist(), _links(drawn, poses[:, near].swapaxes(0, 1), positions), strict=True))
    return tuple(
        Picture(recording.id, float(clock[n]), reduced(frame, LARGEST), links[n])
        for n, frame in enumerate(recording.iter_frames())
        if n in links
    )


def _links(drawn: Skeleton, q: Array, positions: Positions) -> Array:
    """Both ends of every link `[..., L, 2, 2]` in pixels, at positions `[..., nq]`."""
    data = mujoco.MjData(drawn.model)
    mujoco.mj_forward(drawn.model, data)
    height, width = positions.size
    seen = world_to_image(drawn.model, data, drawn.in_space(q), positions.camera, width, height)
    focal = focal_length(drawn.model, positions.camera, height)
    ends = pixels_of(seen, positions.values, positions.size, focal)
    return np.stack([ends[..., [link.start, link.end], :] for link in drawn.links], axis=-3)
