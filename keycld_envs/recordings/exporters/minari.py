"""Recordings as a data set of Minari."""

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from keycld_envs import __version__
from keycld_envs.files import atomic_folder
from keycld_envs.optional import optional
from keycld_envs.progress import progress
from keycld_envs.recordings.exporters.rows import Rows, about, check_alike, on_one_clock
from keycld_envs.recordings.importers.minari import FIELDS
from keycld_envs.recordings.recording import Recording


def write_minari(recordings: Sequence[Recording], out: Path) -> list[str]:
    """Write an episode per recording: observations `time`, `qpos`, `qvel`, `frames`, in the recording's units, actions.

    Numbers are float64 and frames are stored without loss. Rewards are zero; each episode ends truncated.

    Args:
        recordings: with the same joints, actuators and signals.
        out: folder to create; below MINARI_DATASETS_PATH, it is what `minari.load_dataset` finds.

    Returns:
        What Minari cannot hold, a sentence each.

    Raises:
        FileExistsError: if the folder exists.
        InputError: if the package minari is missing, or recordings differ.
    """
    buffer = optional("minari.data_collector", "minari", "Minari data sets").EpisodeBuffer
    new = optional("minari.dataset.minari_storage", "minari", "Minari data sets").MinariStorage.new
    optional("h5py", "minari", "Minari data sets")
    check_alike(recordings)
    out = out.resolve()  # Minari joins a relative path with itself
    lost: dict[str, None] = {}
    with atomic_folder(out) as folder, progress("Export", len(recordings)) as advance:
        (folder / "data").mkdir()
        storage = None
        for recording in recordings:
            rows = on_one_clock(recording)
            observations = _observations(rows)
            if storage is None:
                space = spaces.Dict({name: _space(array) for name, array in observations.items()})
                storage = new(folder / "data", space, _space(rows.action), jpeg_encoding=False)
                storage.update_metadata(_metadata(out.name, recordings))
            steps = len(rows.action)
            ended = np.arange(steps) == steps - 1
            episode = buffer(
                observations=observations,
                actions=rows.action,
                rewards=np.zeros(steps),
                terminations=np.zeros(steps, bool),
                truncations=ended,
            )
            storage.update_episodes([episode])
            lost |= dict.fromkeys(rows.lost)
            advance()
    return list(lost)


def _metadata(name: str, recordings: Sequence[Recording]) -> dict[str, Any]:
    return {
        "dataset_id": f"{name}-v0",
        "minari_version": version("minari"),
        "description": f"Recordings exported by keycld {__version__}",
        FIELDS: [json.dumps(about(recording)) for recording in recordings],
    }


def _observations(rows: Rows) -> dict[str, Any]:
    """`[T, ...]` each."""
    out = {"time": rows.clock, "qpos": rows.qpos, "qvel": rows.qvel}
    if rows.recording.num_frames:
        out["frames"] = rows.recording.load_frames()
    return {name: array for name, array in out.items() if array is not None}


def _space(array: Any) -> spaces.Box:
    """Of one row."""
    if array.dtype == np.uint8:
        return spaces.Box(0, 255, array.shape[1:], np.uint8)
    return spaces.Box(-np.inf, np.inf, array.shape[1:], np.float64)
