"""Data sets of Minari, the format of Farama for offline reinforcement learning: steps of environments of Gymnasium."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError, reason
from keycld_envs.optional import optional
from keycld_envs.reading import check_size
from keycld_envs.recordings.importers.episode import Episode, stored_fields
from keycld_envs.recordings.importers.mapping import Columns
from keycld_envs.recordings.importers.table import Table

METADATA = "data/metadata.json"
FIELDS = "keycld_recordings"
"""Key of the metadata under which `keycld export` keeps what Minari has no place for, one JSON object per episode."""


class MinariFolder:
    """A data set in a folder.

    Attributes:
        folder: where it lies.
        length: number of episodes.

    Raises:
        InputError: if the package minari is missing, or the folder is no data set of it.
    """

    def __init__(self, folder: Path, camera: str | None = None) -> None:
        """Read what there is; `camera` is the observation that holds frames, "none" for no frames."""
        self.folder, self._camera = folder, camera
        minari = optional("minari", "minari", "Minari data sets")
        try:
            self._data = minari.MinariDataset(folder.resolve() / "data")
            self.length = len(self._data)
            self._fields = [json.loads(text) for text in self._data.storage.metadata.get(FIELDS, ())]
        except (OSError, ValueError, LookupError, TypeError, ImportError, AssertionError) as error:
            raise self._damaged("data", error) from error

    def __iter__(self) -> Iterator[Episode]:
        """All episodes, read one at a time.

        Raises:
            InputError: if one is damaged, or has no frames of that name.
        """
        for i in range(self.length):
            try:
                size = self._data.storage.get_size() * 1e6 / self.length
                check_size(size)
                episode = self._episode(i, self._data[i])
            except InputError:
                raise
            except (OSError, ValueError, LookupError, TypeError, RuntimeError) as error:
                raise self._damaged(f"episode {i}", error) from error
            yield episode

    def _episode(self, index: int, data: Any) -> Episode:
        arrays = dict(_arrays("observations", data.observations)) | dict(_arrays("actions", data.actions))
        frames = self._frames(arrays)
        steps = len(data.rewards)
        columns = {"step": np.arange(steps + 1.0), "action_step": np.arange(float(steps))}
        for name, array in arrays.items():
            if array.ndim <= 2 and array.dtype.kind in "fiub":
                columns |= _columns(name, array.astype(float))
        mapping, fields = Columns("step", {}), {}
        if self._fields:
            fields = stored_fields(self._fields[index])
            columns = {name.removeprefix("observations."): column for name, column in columns.items()}
            columns["action_time"] = columns["time"][:steps]
            mapping = _mapping(fields, columns)
        return Episode(f"episode-{index:06d}", Table(self.folder, columns), mapping, frames, fields)

    def _frames(self, arrays: dict[str, NDArray[Any]]) -> NDArray[np.uint8] | None:
        images = {n: a for n, a in arrays.items() if a.ndim == 4 and a.shape[3] == 3 and a.dtype == np.uint8}
        if self._camera == "none" or (self._camera is None and not images):
            return None
        if self._camera is not None and self._camera not in images:
            known = ", ".join(images) or "none"
            raise InputError(f"{self.folder}: there are no frames {self._camera!r}; there are {known}.")
        return images[self._camera or next(iter(images))]

    def _damaged(self, where: str, error: Exception) -> InputError:
        return InputError(f"{self.folder}, {where}, cannot be read ({reason(error)}); name a whole Minari data set.")


def _arrays(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """Names and arrays of a space's leaves."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _arrays(f"{name}.{key}", inner)
    elif isinstance(value, tuple):
        for i, inner in enumerate(value):
            yield from _arrays(f"{name}[{i}]", inner)
    else:
        yield name, np.asarray(value)


def _columns(name: str, array: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    if array.ndim == 1:
        return {name: array}
    return {f"{name}[{i}]": column for i, column in enumerate(array.T)}


def _mapping(fields: Mapping[str, Any], columns: Mapping[str, Any]) -> Columns:
    """Which column is what in a data set that `keycld export` wrote."""
    joints, actuators = fields["joint_names"], fields["actuator_names"]

    def named(signal: str, names: list[str]) -> dict[str, str]:
        return {name: f"{signal}[{i}]" for i, name in enumerate(names) if f"{signal}[{i}]" in columns}

    return Columns("time", named("qpos", joints), named("qvel", joints), named("actions", actuators), "action_time")
