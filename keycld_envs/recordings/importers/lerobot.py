"""Data sets of LeRobot, version 3: many episodes in files of Parquet and MP4.

The format is described at https://huggingface.co/docs/lerobot/lerobot-dataset-v3.
"""

import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from keycld_envs.errors import InputError, reason
from keycld_envs.optional import optional
from keycld_envs.reading import check_file, check_size, read_json
from keycld_envs.recordings.importers.episode import Episode, stored_fields
from keycld_envs.recordings.importers.mapping import Columns
from keycld_envs.recordings.importers.table import Table
from keycld_envs.recordings.video import Frame, decode

INFO = "meta/info.json"
STATE, VELOCITY, ACTION = "observation.state", "observation.velocity", "action"
FIELDS = "keycld.recording"
"""Column of the episodes in which `keycld export` keeps what LeRobot has no place for, as JSON."""
TOLERANCE_S = 1e-4
"""Within which LeRobot takes time stamps for frame index / fps."""
_NUMERIC = ("float", "int", "bool", "uint")


class LeRobotFolder:
    """A data set in a folder.

    Attributes:
        folder: where it lies.
        length: number of episodes.

    Raises:
        InputError: if the package pyarrow is missing, or the folder is no data set of version 3.
    """

    def __init__(self, folder: Path, camera: str | None = None) -> None:
        """Read what there is; `camera` is the key of the frames, "none" for no frames, by default the first."""
        self.folder = folder
        self._parquet = optional("pyarrow.parquet", "lerobot", "LeRobot data sets")
        with _whole(folder, INFO):
            self._info = read_json(folder / INFO)
            version = str(self._info["codebase_version"])
            self._features: dict[str, Mapping[str, Any]] = self._info["features"]
            self._fps = float(self._info["fps"])
        if not version.startswith("v3"):
            raise InputError(
                f"{folder / INFO}: codebase_version is {version!r}, only v3 is read; convert it with LeRobot's "
                "convert_dataset_v21_to_v30."
            )
        with _whole(folder, "meta/episodes"):
            files = sorted((folder / "meta/episodes").glob("*/*.parquet"))
            rows = [row for file in files for row in self._read(file).to_pylist()]
            self._episodes = sorted(rows, key=lambda row: row["episode_index"])
        if not self._episodes:
            raise InputError(f"{folder}/meta/episodes lists no episodes; name a whole LeRobot data set.")
        self.length = len(self._episodes)
        self._camera = self._camera_key(camera)

    def __iter__(self) -> Iterator[Episode]:
        """All episodes, read one at a time.

        Raises:
            InputError: if a file is missing, damaged, or would fill the memory.
        """
        data, path, video = None, None, _Video()
        for row in self._episodes:
            index = row["episode_index"]
            with _whole(self.folder, f"episode {index}"):
                if path != (path := self._path("data_path", row, "data")):
                    data = self._read(path)
                assert data is not None
                start, length = self._row_of(data, index), row["length"]
                columns = self._columns(data.slice(start, length))
                frames = self._frames(row, data.slice(start, length), video)
                episode = self._episode(row, columns, frames)
            yield episode

    def _episode(self, row: Mapping[str, Any], columns: dict[str, Any], frames: NDArray[np.uint8] | None) -> Episode:
        fields = json.loads(row[FIELDS]) if row.get(FIELDS) else {}
        start, actions = fields.pop("start", 0.0), fields.pop("num_actions", row["length"])
        index = columns["frame_index"]
        stamps = columns["timestamp"]
        even = np.abs(stamps - index / self._fps).max() <= TOLERANCE_S  # then stamps are that, rounded to float32
        columns["timestamp"] = start + (index / self._fps if even else stamps)
        columns["action_timestamp"] = columns["timestamp"][:actions]
        for name in columns:
            if name.startswith(f"{ACTION}."):
                columns[name] = columns[name][:actions]
        joints, velocities, commands = (self._named(feature) for feature in (STATE, VELOCITY, ACTION))
        mapping = Columns("timestamp", joints, velocities, commands, "action_timestamp" if commands else None)
        id = f"episode-{row['episode_index']:06d}"
        return Episode(id, Table(self.folder, columns), mapping, frames, stored_fields(fields) if fields else {})

    def _named(self, feature: str) -> dict[str, str]:
        """Columns of a feature by joint; a trailing .pos or .vel is no part of the joint's name."""
        names = self._names(feature) if feature in self._features else []
        return {name.removesuffix(".pos").removesuffix(".vel"): f"{feature}.{name}" for name in names}

    def _names(self, feature: str) -> list[str]:
        """Of the entries of a vector: as written, or their numbers."""
        names = self._features[feature].get("names")
        if isinstance(names, Mapping):
            names = next(iter(names.values()), None)
        size = int(np.prod(self._features[feature]["shape"]))
        return [str(name) for name in names] if names and len(names) == size else [str(i) for i in range(size)]

    def _columns(self, data: Any) -> dict[str, NDArray[np.float64]]:
        """Every number of every row."""
        out = {}
        for feature, about in self._features.items():
            if not str(about["dtype"]).startswith(_NUMERIC) or len(about["shape"]) != 1:
                continue
            rows = np.array(data.column(feature).to_pylist(), float).reshape(data.num_rows, -1)
            if about["shape"][0] == 1 and not about.get("names"):
                out[feature] = rows[:, 0]
            else:
                out |= {f"{feature}.{name}": rows[:, i] for i, name in enumerate(self._names(feature))}
        return out

    def _frames(self, row: Mapping[str, Any], data: Any, video: "_Video") -> NDArray[np.uint8] | None:
        if self._camera is None:
            return None
        about, length = self._features[self._camera], data.num_rows
        if about["dtype"] == "video":
            path = self._path("video_path", row, f"videos/{self._camera}")
            first = round(row[f"videos/{self._camera}/from_timestamp"] * self._fps)
            return video.frames(path, first, length)
        images = (Image.open(io.BytesIO(image["bytes"])) for image in data.column(self._camera).to_pylist())
        return np.stack([np.asarray(image.convert("RGB")) for image in images])

    def _camera_key(self, wanted: str | None) -> str | None:
        keys = [key for key, about in self._features.items() if about["dtype"] in ("video", "image")]
        if wanted == "none" or (wanted is None and not keys):
            return None
        if wanted is not None and wanted not in keys:
            raise InputError(f"{self.folder}: there is no camera {wanted!r}; there are {', '.join(keys) or 'none'}.")
        return wanted or keys[0]

    def _path(self, kind: str, row: Mapping[str, Any], prefix: str) -> Path:
        chunk, file = row[f"{prefix}/chunk_index"], row[f"{prefix}/file_index"]
        name = self._info[kind].format(video_key=self._camera, chunk_index=chunk, file_index=file)
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ValueError(f"{kind} {name!r} leads out of the folder")
        return self.folder / name

    def _row_of(self, data: Any, index: int) -> int:
        return int(np.flatnonzero(data.column("episode_index").to_numpy() == index)[0])

    def _read(self, path: Path) -> Any:
        meta = self._parquet.read_metadata(check_file(path))
        check_size(sum(meta.row_group(i).total_byte_size for i in range(meta.num_row_groups)))
        return self._parquet.read_table(path)


@contextmanager
def _whole(folder: Path, where: str) -> Iterator[None]:
    """Turn errors of damaged files into one sentence."""
    try:
        yield
    except InputError:
        raise
    except (OSError, ValueError, LookupError, TypeError, RuntimeError) as error:
        raise InputError(
            f"{folder}, {where}, cannot be read ({reason(error)}); name a whole LeRobot data set."
        ) from error


class _Video:
    """Frames of episodes that follow each other in one file, which is decoded once."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._decoded: Iterator[Frame] = iter(())
        self._next = 0

    def frames(self, path: Path, first: int, length: int) -> NDArray[np.uint8]:
        """Frames `first` to `first + length` of a file."""
        if path != self._path or first < self._next:
            self._path, self._decoded, self._next = path, decode(path), 0
        chosen: list[Frame] = []
        for frame in islice(self._decoded, first - self._next, first - self._next + length):
            if not chosen:
                check_size(float(frame.nbytes) * length)
            chosen.append(frame)
        self._next = first + length
        if len(chosen) < length:
            raise ValueError(f"{path.name} has {len(chosen)} of {length} frames")
        return np.stack(chosen)
