"""Recordings as a data set of LeRobot, version 3: all episodes in one file of Parquet and one video."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_folder
from keycld_envs.optional import optional
from keycld_envs.progress import progress
from keycld_envs.recordings.exporters.rows import Rows, about, check_alike, on_one_clock
from keycld_envs.recordings.importers.lerobot import ACTION, FIELDS, STATE, TOLERANCE_S, VELOCITY
from keycld_envs.recordings.recording import Recording
from keycld_envs.recordings.video import write_video

CAMERA = "observation.images.camera"
TASK = "Move as recorded."
PLACE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
LOSSLESS = {"pix_fmt_in": "rgb24", "pix_fmt_out": "rgb24", "codec": "libx264rgb", "output_params": ["-qp", "0"]}
INDICES = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64"} | {
    "task_index": "int64"
}
"""Columns that every data set has."""
TASKS_PANDAS = {
    "index_columns": ["__index_level_0__"],
    "column_indexes": [],
    "columns": [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
        {"name": None, "field_name": "__index_level_0__", "pandas_type": "unicode", "numpy_type": "object"},
    ],
    "pandas_version": "2.2.0",
}
"""Tasks are a table of pandas, whose index is the task."""


def write_lerobot(recordings: Sequence[Recording], out: Path) -> list[str]:
    """Write an episode per recording: observation.state, observation.velocity, action, and observation.images.camera.

    Rows are as far apart as LeRobot wants them, 1 / fps; numbers are float32, in the recording's units, which stand
    beside the names of the joints in meta/info.json. Frames are H.264 without loss.

    Args:
        recordings: with the same joints, actuators and signals.
        out: folder to create.

    Returns:
        What LeRobot cannot hold, a sentence each.

    Raises:
        FileExistsError: if the folder exists.
        InputError: if the package pyarrow is missing, recordings differ, or frames come unevenly.
    """
    optional("pyarrow.parquet", "lerobot", "LeRobot data sets")
    check_alike(recordings)
    fps = _rate(recordings[0])
    written = _Written(recordings[0], fps)
    with atomic_folder(out) as folder, progress("Export", len(recordings)) as advance:
        if recordings[0].num_frames:
            width, height = _size(recordings[0])
            video = folder / "videos" / CAMERA / f"{PLACE.format(chunk_index=0, file_index=0)}.mp4"
            video.parent.mkdir(parents=True)
            frames = written.add(recordings, advance, (height, width, 3))
            write_video(video, frames, (width, height), fps, **LOSSLESS)
        else:
            for _ in written.add(recordings, advance, None):
                pass
        _write_tables(folder, written)
    return list(written.lost)


@dataclass
class _Written:
    """What the tables say of the recordings that were added so far."""

    first: Recording
    fps: float
    columns: list[dict[str, NDArray[Any]]] = field(default_factory=list)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    colours: list[NDArray[np.float64]] = field(default_factory=list)
    frame_shape: tuple[int, int, int] | None = None
    lost: dict[str, None] = field(default_factory=lambda: {"numbers are rounded to float32": None})

    def add(self, recordings: Sequence[Recording], advance: Any, shape: Any) -> Iterator[NDArray[np.uint8]]:
        """Add recordings, yielding their frames."""
        self.frame_shape = shape
        for recording in recordings:
            rows, lost = _steady(recording, self.fps)
            self.lost |= dict.fromkeys((*rows.lost, *lost))
            if len(rows.action[0]):
                self.lost["the last row of an episode repeats its last action"] = None
            for frame in rows.frames():
                if frame.shape != shape:
                    raise InputError(f"Recording {recording.id!r} has frames of another size; export it apart.")
                pixels = frame.reshape(-1, 3) / 255.0
                self.colours.append(np.stack([pixels.min(0), pixels.max(0), pixels.mean(0), (pixels**2).mean(0)]))
                yield frame
            self._add_rows(rows)
            advance()

    def _add_rows(self, rows: Rows) -> None:
        length, index = len(rows.clock), len(self.episodes)
        start = self.episodes[-1]["dataset_to_index"] if self.episodes else 0
        steps = np.arange(length)
        columns = {STATE: rows.qpos, VELOCITY: rows.qvel}
        if rows.action.shape[1]:
            columns[ACTION] = np.concatenate([rows.action, rows.action[-1:]])
        indices = (steps / self.fps, steps, np.full(length, index), start + steps, np.zeros(length, int))
        self.columns.append(
            {name: c.astype(np.float32) for name, c in columns.items() if c is not None}
            | {name: c.astype(kind) for (name, kind), c in zip(INDICES.items(), indices, strict=True)}
        )
        fields = about(rows.recording) | {"start": float(rows.clock[0]), "num_actions": length - 1}
        places = ["data", "meta/episodes"] + [f"videos/{CAMERA}"] * (self.frame_shape is not None)
        episode = {"episode_index": index, "tasks": [TASK], "length": length, FIELDS: json.dumps(fields)}
        episode |= {f"{place}/{which}_index": 0 for place in places for which in ("chunk", "file")}
        if self.frame_shape is not None:
            episode[f"videos/{CAMERA}/from_timestamp"] = start / self.fps
            episode[f"videos/{CAMERA}/to_timestamp"] = (start + length) / self.fps
        self.episodes.append(episode | {"dataset_from_index": start, "dataset_to_index": start + length})


def _write_tables(folder: Path, written: _Written) -> None:
    parquet = optional("pyarrow.parquet", "lerobot", "LeRobot data sets")
    arrow = optional("pyarrow", "lerobot", "LeRobot data sets")
    place = f"{PLACE.format(chunk_index=0, file_index=0)}.parquet"
    columns = {name: np.concatenate([c[name] for c in written.columns]) for name in written.columns[0]}
    task_names = arrow.table({"task_index": [0], "__index_level_0__": [TASK]})
    tables = {
        f"data/{place}": arrow.table({name: _cells(arrow, column) for name, column in columns.items()}),
        f"meta/episodes/{place}": arrow.Table.from_pylist(written.episodes),
        "meta/tasks.parquet": task_names.replace_schema_metadata({"pandas": json.dumps(TASKS_PANDAS)}),
    }
    for name, table in tables.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, folder / name)
    for name, content in (("info", _info(written, columns)), ("stats", _stats(written, columns))):
        text = json.dumps(content, indent=4, ensure_ascii=False)
        (folder / f"meta/{name}.json").write_text(text, encoding="utf-8")


def _cells(arrow: Any, column: NDArray[Any]) -> Any:
    """A column of numbers, or of lists of a fixed length; LeRobot has vectors of one number as numbers."""
    if column.ndim == 1 or column.shape[1] == 1:
        return arrow.array(column.reshape(-1))
    return arrow.FixedSizeListArray.from_arrays(arrow.array(column.reshape(-1)), column.shape[1])


def _info(written: _Written, columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    recording, total = written.first, len(columns["index"])
    named = {STATE: (recording.joint_names, "qpos"), VELOCITY: (recording.joint_names, "qvel")}
    named[ACTION] = (recording.actuator_names, "action")
    features: dict[str, Any] = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in INDICES.items()}
    for name, (names, signal) in named.items():
        if name in columns:
            features[name] = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
            features[name]["units"] = recording.units.get(signal)
    if written.frame_shape is not None:
        height, width, channels = written.frame_shape
        about_video = {"video.height": height, "video.width": width, "video.codec": "h264", "video.pix_fmt": "gbrp"}
        about_video |= {"video.fps": written.fps, "video.channels": channels, "video.is_depth_map": False}
        features[CAMERA] = {"dtype": "video", "shape": list(written.frame_shape)}
        features[CAMERA] |= {"names": ["height", "width", "channels"], "info": about_video | {"has_audio": False}}
    return {
        "codebase_version": "v3.0",
        "robot_type": recording.system,
        "total_episodes": len(written.episodes),
        "total_frames": total,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": written.fps,
        "splits": {"train": f"0:{len(written.episodes)}"},
        "data_path": f"data/{PLACE}.parquet",
        "video_path": f"videos/{{video_key}}/{PLACE}.mp4" if written.frame_shape else None,
        "features": features,
    }


def _stats(written: _Written, columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """What LeRobot normalises by; missing samples do not count."""
    out: dict[str, Any] = {}
    for name, column in columns.items():
        rows = column.reshape(len(column), -1).astype(float)
        rows = np.where(np.isfinite(rows).any(axis=0), rows, 0.0)
        stats = {"min": np.nanmin(rows, 0), "max": np.nanmax(rows, 0), "mean": np.nanmean(rows, 0)}
        stats |= {"std": np.nanstd(rows, 0), "count": np.array([len(rows)])}
        stats |= {f"q{round(100 * q):02d}": np.nanquantile(rows, q, axis=0) for q in QUANTILES}
        out[name] = {key: value.tolist() for key, value in stats.items()}
    if written.colours:
        low, high, mean, square = np.stack(written.colours, axis=1)
        mean, square = mean.mean(0), square.mean(0)
        stats = {"min": low.min(0), "max": high.max(0), "mean": mean, "std": np.sqrt(np.maximum(square - mean**2, 0))}
        out[CAMERA] = {key: value.reshape(3, 1, 1).tolist() for key, value in stats.items()}
        out[CAMERA]["count"] = [len(written.colours)]
    return out


def _rate(recording: Recording) -> float:
    """Rows per second: a whole number, but for frames that come at another rate."""
    rate = 1 / np.median(np.diff(on_one_clock(recording).clock))
    if abs(rate - round(rate)) < 1e-3 * rate or not recording.num_frames:
        return max(1, round(rate))
    return float(rate)


def _steady(recording: Recording, fps: float) -> tuple[Rows, tuple[str, ...]]:
    """Rows that are 1 / fps apart, and what became of their clock."""
    rows = on_one_clock(recording)
    clock = rows.clock[0] + np.arange(len(rows.clock)) / fps
    off = float(np.abs(rows.clock - clock).max())
    if off <= TOLERANCE_S:
        return rows, ()
    if not recording.num_frames:
        count = int((rows.clock[-1] - rows.clock[0]) * fps + 1e-6) + 1
        return on_one_clock(recording, clock[0] + np.arange(count) / fps), ()
    if off > 0.5 / fps:
        raise InputError(
            f"Recording {recording.id!r}: frames are up to {off:.3g} s away from a steady {fps:g} per second, which "
            "LeRobot needs; export it to rerun or minari, which keep its clock."
        )
    return rows, ("times of frames are rounded to a steady rate",)


def _size(recording: Recording) -> tuple[int, int]:
    """Width and height of the frames, pixels."""
    frame = next(recording.iter_frames())
    return frame.shape[1], frame.shape[0]
