"""Recordings on disk: one folder each, see docs/recordings.md."""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_folder
from keycld_envs.reading import read_arrays, read_json, read_limit
from keycld_envs.recordings.recording import InvalidRecording, Recording
from keycld_envs.recordings.validation import SIGNALS
from keycld_envs.recordings.video import iter_video, write_video

SCHEMA = "keycld.recording/1"
VIDEO_SUFFIXES = (".mkv", ".mp4", ".mov")
META = tuple(f.name for f in fields(Recording) if f.name not in (*SIGNALS, "frames", "video"))


def write_recording(folder: str | os.PathLike[str], recording: Recording, *, video: bool = False) -> None:
    """Write a recording as a folder that appears complete or not at all.

    Args:
        folder: the folder to create.
        recording: what to write. A recording that refers to a camera's file keeps a copy of it, untouched.
        video: store frames in memory as frames.mkv (FFV1, lossless) instead of frames.npz, which is smaller
            and faster for short rendered clips. Frames that `read_recording` would not take from frames.npz at once
            are stored as a video in any case; see `keycld_envs.reading`.

    Raises:
        InputError: if the folder exists already and is not empty, or a video could not be written whole.
    """
    try:
        with atomic_folder(folder) as partial:
            _write_files(partial, recording, video)
    except FileExistsError as error:
        raise InputError(f"{folder} exists already; choose another folder or remove it.") from error


def read_recording(folder: str | os.PathLike[str]) -> Recording:
    """Read a recording and check all of it, videos included.

    Args:
        folder: a folder in the format `keycld.recording/1`.

    Returns:
        The recording; its `video` is a path when the frames are stored as a video.

    Raises:
        InputError: if anything is missing or wrong; the message names file, key, shape and index.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; a recording is a folder with a meta.json.")
    meta = _read_meta(folder / "meta.json")
    signals = _read_npz(folder / "signals.npz", SIGNALS)
    frames, video = _find_frames(folder)
    try:
        recording = Recording(**meta, **signals, frames=frames, video=video)
    except InvalidRecording as error:
        raise InputError(f"{folder}/{error.problem}") from error
    if video is not None:
        _check_video(recording, video)
    return recording


def _write_files(folder: Path, recording: Recording, video: bool) -> None:
    meta = {"schema": SCHEMA} | {name: getattr(recording, name) for name in META}
    (folder / "meta.json").write_text(json.dumps(meta, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    np.savez(
        folder / "signals.npz", **{key: array for key in SIGNALS if (array := getattr(recording, key)) is not None}
    )
    if recording.video is not None:
        name = "frames.mkv" if recording.video.name == "frames.mkv" else f"original{recording.video.suffix.lower()}"
        shutil.copyfile(recording.video, folder / name)
    elif recording.frames is not None and (video or recording.frames.nbytes > read_limit()):
        assert recording.t_frame is not None
        duration = float(recording.t_frame[-1] - recording.t_frame[0])
        size = recording.frames.shape[2], recording.frames.shape[1]
        rate = (len(recording.frames) - 1) / duration if duration else 25.0
        write_video(folder / "frames.mkv", recording.frames, size, max(1, round(rate)))
    elif recording.frames is not None:
        np.savez_compressed(folder / "frames.npz", frames=recording.frames)


def _read_meta(path: Path) -> dict[str, Any]:
    try:
        meta = read_json(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} is missing; a recording needs one, see docs/recordings.md.") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not readable JSON ({error}); repair or replace it.") from error
    schema = meta.pop("schema", None) if isinstance(meta, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{path}: schema is {schema!r}; this version of keycld reads {SCHEMA!r}.")
    if missing := [name for name in META if name not in meta]:
        raise InputError(f"{path}: {missing[0]} is missing; add it.")
    if unknown := [name for name in meta if name not in META]:
        raise InputError(f"{path}: the field {unknown[0]!r} is unknown; known are {', '.join(META)}.")
    for name in ("joint_names", "actuator_names"):
        if isinstance(meta[name], list):
            meta[name] = tuple(meta[name])
    if isinstance(meta["units"], Mapping):
        meta["units"] = {k: tuple(v) if isinstance(v, list) else v for k, v in meta["units"].items()}
    return meta


def _read_npz(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    try:
        arrays = read_arrays(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} is missing; a recording needs one, see docs/recordings.md.") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is damaged or not an npz file ({error}); replace it.") from error
    if unknown := [key for key in arrays if key not in keys]:
        raise InputError(f"{path}: the key {unknown[0]!r} is unknown; known are {', '.join(keys)}.")
    return arrays


def _find_frames(folder: Path) -> tuple[NDArray[np.uint8] | None, Path | None]:
    candidates = [folder / "frames.npz", folder / "frames.mkv"]
    candidates += sorted(p for p in folder.glob("original.*") if p.suffix.lower() in VIDEO_SUFFIXES)
    found = [path for path in candidates if path.exists()]
    if len(found) > 1:
        raise InputError(f"{folder} holds both {found[0].name} and {found[1].name}; keep one.")
    if not found:
        return None, None
    if found[0].name != "frames.npz":
        return None, found[0]
    arrays = _read_npz(found[0], ("frames",))
    if "frames" not in arrays:
        raise InputError(f"{found[0]}: the key 'frames' is missing; store the frames under it.")
    return arrays["frames"], None


def _check_video(recording: Recording, path: Path) -> None:
    size = None
    for frame in iter_video(path, recording.num_frames):
        size = frame.shape[1], frame.shape[0]
    camera = recording.camera
    if camera is not None and size != (camera["width"], camera["height"]):
        assert size is not None
        raise InputError(
            f"{path} is {size[0]}×{size[1]} pixels, but camera in meta.json says "
            f"{camera['width']}×{camera['height']}; correct one of them."
        )
