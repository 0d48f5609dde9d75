"""The folder of a track: a recording, with overlay.mp4, report.html and track.json beside its signals."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_control.plain_json import write_json
from keycld_control.tracking.overlay import clip_size, draw_overlay
from keycld_control.tracking.page import OVERLAY, html_page
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_folder
from keycld_envs.progress import Advance
from keycld_envs.recordings import Recording, write_recording
from keycld_envs.recordings.storage import VIDEO_SUFFIXES
from keycld_envs.recordings.video import H264, write_video
from keycld_model.tracking import Track
from keycld_model.tracking.pendulum import Study

PIECES = 6
"""Pictures in the strip of the page."""


def recording_of(track: Track, name: str, licence: str = "", origin: str = "") -> Recording:
    """A track as a recording: the video itself, keypoints in its pixels, and angles as joint positions."""
    width, height = track.film.size
    return Recording(
        id=name,
        source="real",
        joint_names=tuple(f"joint_{k + 1}" for k in range(track.angles.shape[1])),
        units={"qpos": "rad"},
        camera={"width": width, "height": height},
        licence=licence,
        origin=origin or track.film.path.name,
        notes="qpos by keycld track, counter-clockwise: first rod from the picture's downward direction, others "
        "from the rod before. NaN where a keypoint was not found, or a rod has not its length.",
        t_state=track.film.times,
        qpos=np.where(track.trusted, track.angles, np.nan),
        qpos_std=np.where(track.trusted, track.deviation, np.nan),
        t_frame=track.film.times,
        keypoints=track.keypoints,
        keypoint_covariance=track.covariance,
        pivot=track.pivot,
        video=track.film.path,
    )


def check_out(out: Path, video: Path) -> None:
    """Refuse what could not be saved, before any work is done.

    Raises:
        InputError: if `out` exists and is not empty, or recordings cannot keep such a video.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out: {out} exists; name a new folder.")
    if video.suffix.lower() not in VIDEO_SUFFIXES:
        raise InputError(
            f"{video} ends in {video.suffix!r}; recordings keep {', '.join(VIDEO_SUFFIXES)}, so convert it."
        )


def save(
    out: Path, recording: Recording, track: Track, study: Study | None, numbers: Mapping[str, Any], advance: Advance
) -> None:
    """Write the folder, which appears complete or not at all.

    Args:
        out: the folder to create.
        recording: by `recording_of`.
        track: what was followed.
        study: of a free pendulum.
        numbers: by `keycld_control.tracking.summary.summary`.
        advance: a progress bar, one step per frame.
    """
    chosen = set(np.linspace(0, len(track.film) - 1, PIECES).round().astype(int).tolist())
    strip: list[NDArray[np.uint8]] = []

    def frames() -> Any:
        for t, picture in enumerate(draw_overlay(track, study, advance)):
            if t in chosen:
                strip.append(picture)
            yield picture

    with atomic_folder(out) as partial:
        write_recording(partial, recording)
        rate = (len(track.film) - 1) / float(np.ptp(track.film.times))
        write_video(
            partial / OVERLAY,
            frames(),
            clip_size(track),
            rate,
            **H264,
        )
        (partial / "report.html").write_text(html_page(track, study, numbers, strip), encoding="utf-8")
        write_json(partial / "track.json", numbers)
