"""A data set: a folder of recordings."""

import hashlib
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.checks import check_number
from keycld_envs.errors import InputError
from keycld_envs.recordings.recording import Recording
from keycld_envs.recordings.storage import read_recording
from keycld_envs.recordings.validation import SIGNALS


@dataclass(frozen=True, eq=False)
class Sequences:
    """Recordings of one length, one image size and one steady frame rate, stacked for training.

    Attributes:
        frames: [N, T, H, W, 3] uint8.
        actions: [N, T-1, m]; actions[:, i] acts between frames i and i+1.
        qpos: [N, T, nq] joint positions at the frames, rad or m; None unless every recording has them.
        timestep: seconds between frames.
    """

    frames: NDArray[np.uint8]
    actions: NDArray[np.float64]
    qpos: NDArray[np.float64] | None
    timestep: float

    def cut(self, length: int) -> "Sequences":
        """Consecutive parts of at most `length` frames, all equally long; what is left at the end is dropped."""
        t = self.frames.shape[1]
        length = min(length, t)
        starts = range(0, t - length + 1, length)
        return Sequences(
            np.concatenate([self.frames[:, s : s + length] for s in starts]),
            np.concatenate([self.actions[:, s : s + length - 1] for s in starts]),
            None if self.qpos is None else np.concatenate([self.qpos[:, s : s + length] for s in starts]),
            self.timestep,
        )


@dataclass(frozen=True, eq=False)
class Dataset:
    """Recordings of one folder, in the order of their folder names.

    Attributes:
        folder: where they were read.
        recordings: at least one.
        damaged: what is wrong with each recording that was skipped on request.
    """

    folder: Path
    recordings: tuple[Recording, ...]
    damaged: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.recordings)

    def __iter__(self) -> Iterator[Recording]:
        return iter(self.recordings)

    @cached_property
    def sha256(self) -> str:
        """Hash of the content: system, names, clocks, signals and pixels, however the frames are stored."""
        digest = hashlib.sha256()
        for recording in self.recordings:
            digest.update(repr((recording.id, recording.system, recording.joint_names)).encode())
            for key in SIGNALS:
                if (array := getattr(recording, key)) is not None:
                    digest.update(f"{key}{array.shape}".encode())
                    digest.update(array.tobytes())
            for frame in recording.iter_frames():
                digest.update(f"{frame.shape}".encode())
                digest.update(frame.tobytes())
        return digest.hexdigest()

    @property
    def system(self) -> str | None:
        """The environment id all recordings share, None for a system without an environment.

        Raises:
            InputError: if recordings of different systems stand in one folder.
        """
        systems = {recording.system for recording in self.recordings}
        if len(systems) > 1:
            names = " and ".join(sorted(map(str, systems))[:2])
            raise InputError(f"{self.folder} mixes recordings of {names}; keep one system per data set.")
        return systems.pop()

    def split(self, validation: float = 0.1) -> tuple["Dataset", "Dataset"]:
        """Divide into training and validation recordings, spread evenly over the folder.

        Depends on the order only, and adding recordings at the end moves none between the parts: with the
        default every tenth recording validates (500 give the paper's 450 and 50).

        Args:
            validation: fraction held out, between 0 and 1; at least one recording is held out.

        Returns:
            (training, validation).

        Raises:
            InputError: if there are fewer than two recordings, or the fraction is none.
        """
        check_number("validation", validation, 0.0, 1.0)
        if len(self) < 2:
            raise InputError(f"{self.folder} holds one recording; a training and a validation part need two.")
        held_out = {i for i in range(len(self)) if int((i + 1) * validation + 1e-9) > int(i * validation + 1e-9)}
        held_out = held_out or {len(self) - 1}
        if len(held_out) == len(self):
            raise InputError(f"validation={validation:g} leaves no recording for training; choose a smaller fraction.")
        training = tuple(r for i, r in enumerate(self.recordings) if i not in held_out)
        return (
            replace(self, recordings=training),
            replace(self, recordings=tuple(self.recordings[i] for i in sorted(held_out))),
        )

    def sequences(self) -> Sequences:
        """Stack frames, actions and joint positions of all recordings on the clock of the frames.

        Raises:
            InputError: if systems, lengths, image sizes or frame rates differ, a frame rate is not steady within 5 %,
                or a recording has no frames.
        """
        _ = self.system  # one, or an error
        first = self.recordings[0]
        shape, timestep = first.load_frames().shape, _timestep(first)
        frames = np.empty((len(self), *shape), np.uint8)
        actions, positions = [], []
        for i, recording in enumerate(self.recordings):
            images = recording.load_frames()
            if images.shape != shape:
                raise InputError(
                    f"{self.folder}: {recording.id} has {_describe(images.shape)}, but {first.id} has "
                    f"{_describe(shape)}; stack recordings of one length and image size."
                )
            if abs(_timestep(recording) / timestep - 1) > 0.05:
                raise InputError(
                    f"{self.folder}: {recording.id} has a frame every {_timestep(recording):g} s, but {first.id} every "
                    f"{timestep:g} s; stack recordings of one frame rate."
                )
            if recording.actuator_names != first.actuator_names or recording.joint_names != first.joint_names:
                raise InputError(
                    f"{self.folder}: {recording.id} and {first.id} name different joints or actuators; "
                    "stack recordings of one system."
                )
            assert recording.t_frame is not None
            frames[i] = images
            actions.append(recording.mean_actions(recording.t_frame))
            positions.append(recording.positions_at(recording.t_frame))
        if len({a.shape for a in actions}) > 1:
            raise InputError(f"{self.folder}: some recordings have no actions; record them for all or for none.")
        qpos = None if any(p is None for p in positions) else np.stack(positions)
        return Sequences(frames, np.stack(actions), qpos, timestep)


def read_dataset(folder: str | os.PathLike[str], *, skip_damaged: bool = False) -> Dataset:
    """Read and check all recordings of a folder.

    Args:
        folder: a folder whose sub-folders are recordings; files and hidden folders are ignored.
        skip_damaged: leave out damaged recordings with a warning each instead of refusing the data set.

    Returns:
        The recordings in the order of their folder names.

    Raises:
        InputError: if the folder is missing or holds no recording, or one is damaged.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "is a file; name a folder of recordings" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {what}; `keycld collect` makes a data set.")
    if (folder / "meta.json").exists():
        raise InputError(f"{folder} is one recording; name the folder that holds it.")

    recordings, damaged = [], []
    for path in sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")):
        try:
            recordings.append(read_recording(path))
        except InputError as error:
            if not skip_damaged:
                raise
            damaged.append(str(error))
            warnings.warn(f"Skipped: {error}", stacklevel=2)
    if not recordings:
        why = "only damaged recordings" if damaged else "no recordings"
        raise InputError(f"{folder} holds {why}; `keycld collect` makes a data set.")
    names = [recording.id for recording in recordings]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{folder} holds two recordings with the id {twice!r}; give each its own.")
    return Dataset(folder, tuple(recordings), tuple(damaged))


def _timestep(recording: Recording) -> float:
    """Seconds between frames of a steady recording."""
    assert recording.t_frame is not None
    if recording.num_frames < 2:
        raise InputError(f"Recording {recording.id!r} has one frame; motion needs at least two.")
    steps = np.diff(recording.t_frame)
    middle = float(np.median(steps))
    off = np.abs(steps - middle) > 0.05 * middle
    if middle <= 0 or off.any():
        i = int(np.argmax(off)) if middle > 0 else int(np.argmin(steps))
        raise InputError(
            f"Recording {recording.id!r}: frames {i} and {i + 1} are {steps[i]:g} s apart, others {middle:g} s; "
            "cut the recording into parts with a steady frame rate."
        )
    return middle


def _describe(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} frames of {shape[2]}×{shape[1]} pixels"
