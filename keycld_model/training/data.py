"""Recordings as the arrays that training needs."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Dataset
from keycld_model.config import ModelConfig
from keycld_model.numerics import evenly_spaced

SHORTEST = 8
"""Frames; fewer leave nothing to fit a motion to."""


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Sequences of equal length.

    Attributes:
        frames: [N, T, H, W, 3] uint8.
        actions: [N, T-1, m] float32, held between frames.
        timestep: seconds between frames.
    """

    frames: NDArray[np.uint8]
    actions: NDArray[np.float32]
    timestep: float
    memory: dict[str, Any] = field(default_factory=dict, repr=False)
    """What was last computed from all frames; see `keypoint_table`."""

    @classmethod
    def from_dataset(cls, dataset: Dataset, length: int = 50) -> "TrainingData":
        """Cut the recordings into sequences of at most `length` frames.

        Raises:
            InputError: if the recordings cannot be stacked, have no actions, or are shorter than 8 frames.
        """
        stacked = dataset.sequences()
        t = stacked.frames.shape[1]
        if t < SHORTEST:
            raise InputError(f"{dataset.folder}: recordings have {t} frames; training needs at least {SHORTEST}.")
        cut = stacked.cut(length)
        return cls(cut.frames, cut.actions.astype(np.float32), cut.timestep)

    @property
    def num_sequences(self) -> int:
        """N."""
        return self.frames.shape[0]

    @property
    def length(self) -> int:
        """T, frames per sequence."""
        return self.frames.shape[1]

    @cached_property
    def flat_frames(self) -> NDArray[np.uint8]:
        """[N*T, H, W, 3], sequence by sequence."""
        return self.frames.reshape(-1, *self.frames.shape[2:])

    def spread(self, number: int) -> NDArray[np.int64]:
        """Numbers of at most `number` frames of `flat_frames`, from all over the recordings."""
        return evenly_spaced(len(self.flat_frames), number)

    @cached_property
    def mean_frame(self) -> NDArray[np.float32]:
        """[H, W, 3] mean of all frames, 0 to 1."""
        total = np.zeros(self.frames.shape[2:], np.float64)
        for sequence in self.frames:
            total += sequence.sum(axis=0, dtype=np.uint32)
        return (total / (255.0 * len(self.flat_frames))).astype(np.float32)


def check_fits(data: TrainingData, config: ModelConfig, dataset: Dataset) -> None:
    """Raise InputError if data are not of the size, actions and rate that a model is configured for."""
    shape = data.frames.shape[2:4]
    if shape != config.image_shape:
        raise InputError(
            f"{dataset.folder} has frames of {shape[1]}x{shape[0]} pixels, the model expects "
            f"{config.image_shape[1]}x{config.image_shape[0]}; change image_shape or the data set."
        )
    if data.actions.shape[2] != config.mechanism.num_actions:
        raise InputError(
            f"{dataset.folder} has {data.actions.shape[2]} actions per frame, the mechanism has "
            f"{config.mechanism.num_actions}; train with the system that was recorded."
        )
    if abs(data.timestep / config.timestep - 1) > 0.05:
        raise InputError(
            f"{dataset.folder} has a frame every {data.timestep:g} s, the model expects {config.timestep:g} s; "
            "change timestep or the data set."
        )
