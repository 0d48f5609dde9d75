"""Recordings as files of Rerun (.rrd), to look at them: every signal on its own clock."""

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from keycld_envs.files import atomic_folder
from keycld_envs.optional import optional
from keycld_envs.progress import progress
from keycld_envs.recordings.recording import Recording

TIMELINE = "time"
JPEG_QUALITY = 95
PIXEL_CENTRE = 0.5
"""Where Rerun has the centre of the first pixel, pixels; recordings have it at 0."""


def write_rerun(recordings: Sequence[Recording], out: Path, document: str | None = None) -> list[str]:
    """Write a file OUT/ID.rrd per recording: `rerun OUT/*.rrd` shows them.

    `qpos/JOINT`, `qvel/JOINT` and `action/ACTUATOR` are curves, `camera` has the frames, `camera/keypoints` and
    `camera/pivot` what was tracked in them; all on the timeline "time", in the recording's seconds.

    Args:
        recordings: to write.
        out: folder to create.
        document: text in Markdown, which is shown beside, as of a diagnosis.

    Returns:
        What Rerun does not hold, a sentence each.

    Raises:
        FileExistsError: if the folder exists.
        InputError: if the package rerun-sdk is missing.
    """
    rr = optional("rerun", "rerun", "Files of Rerun")
    lost: dict[str, None] = {}
    with atomic_folder(out) as folder, progress("Export", len(recordings)) as advance:
        for recording in recordings:
            stream = rr.RecordingStream("keycld", recording_id=recording.id)
            stream.save(folder / (re.sub(r"[^\w. -]", "_", recording.id) + ".rrd"))
            _curves(rr, stream, recording)
            _camera(rr, stream, recording)
            if document is not None:
                stream.log("diagnosis", rr.TextDocument(document, media_type=rr.MediaType.MARKDOWN), static=True)
            about = f"{recording.source}, system {recording.system}, {recording.origin} {recording.notes}".strip()
            stream.log("about", rr.TextDocument(about), static=True)
            stream.flush()
            stream.disconnect()
            if recording.video is not None:
                lost[f"frames of videos are stored as JPEG of quality {JPEG_QUALITY}"] = None
            if recording.qpos_std is not None or recording.keypoint_covariance is not None:
                lost["standard deviations and covariances are left out"] = None
            advance()
    return list(lost)


def _curves(rr: Any, stream: Any, recording: Recording) -> None:
    for signal, clock, names in (
        ("qpos", recording.t_state, recording.joint_names),
        ("qvel", recording.t_state, recording.joint_names),
        ("action", recording.t_action, recording.actuator_names),
    ):
        values: NDArray[np.float64] | None = getattr(recording, signal)
        if values is None or clock is None:
            continue
        units = recording.units.get(signal, "")
        for i, name in enumerate(names):
            unit = units if isinstance(units, str) else units[i]
            path = [signal, name]
            stream.log(path, rr.SeriesLines(names=f"{name} [{unit}]"), static=True)
            times = [rr.TimeColumn(TIMELINE, duration=clock)]
            stream.send_columns(rr.new_entity_path(path), times, rr.Scalars.columns(scalars=values[:, i]))


def _camera(rr: Any, stream: Any, recording: Recording) -> None:
    lossless = recording.video is None
    for i, frame in enumerate(recording.iter_frames()):
        assert recording.t_frame is not None
        stream.set_time(TIMELINE, duration=float(recording.t_frame[i]))
        stream.log("camera", rr.EncodedImage(contents=_encoded(frame, lossless), media_type=_media(lossless)))
        for name, marks in (("keypoints", recording.keypoints), ("pivot", recording.pivot)):
            if marks is not None:
                found = np.atleast_2d(marks[i]) + PIXEL_CENTRE
                stream.log(f"camera/{name}", rr.Points2D(found[np.isfinite(found).all(axis=1)], radii=2.0))


def _encoded(frame: NDArray[np.uint8], lossless: bool) -> bytes:
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "PNG" if lossless else "JPEG", quality=JPEG_QUALITY)
    return file.getvalue()


def _media(lossless: bool) -> str:
    return "image/png" if lossless else "image/jpeg"
