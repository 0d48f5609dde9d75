"""The seam between motions and what is measured of them."""

from collections.abc import Sequence
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.inputs.observation.nuisance import Nuisance

Array = NDArray[np.float64]


class Observation(Protocol):
    """A measurement of m channels of a mechanism with nv joints.

    The simulator knows joints alone, and the rest of the diagnosis knows channels alone; here they meet.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each channel."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each channel."""
        ...

    @property
    def noise(self) -> Array:
        """Standard deviation of each channel's noise, `[m]`; NaN before `calibrated`."""
        ...

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Errors of the sensor that are refitted."""
        ...

    def calibrated(self, recordings: Sequence[Recording]) -> Self:
        """The same with the noise that recordings show.

        Raises:
            InputError: if they are too short for that.
        """
        ...

    def check(self, recording: Recording) -> None:
        """Raise InputError, with the field and the remedy, if a recording does not hold what is observed."""
        ...

    def measured(self, recording: Recording) -> Array:
        """What the sensor showed at `recording.t_state`, `[N, m]`; NaN where samples are missing."""
        ...

    def weights(self, recording: Recording) -> Array | None:
        """Noise of each channel over that of each sample, `[N, m]`; None where all samples are alike."""
        ...

    def positions(self, measured: Array) -> Array:
        """Joint positions `[..., nv]`, rad or m, as far as measurements `[..., m]` tell them."""
        ...

    def initial_state(self, time: Array, measured: Array) -> tuple[Array, Array]:
        """Positions and velocities `[nv]` at time zero, from a window's samples `[n]` and `[n, m]`."""
        ...

    def predict(self, q: Array, v: Array, values: Sequence[float] | Array) -> Array:
        """What the sensor shows, `[..., m]`.

        Args:
            q: joint positions `[..., nv]`, rad or m.
            v: joint velocities `[..., nv]`.
            values: of the nuisances.
        """
        ...


@runtime_checkable
class BoundedNoise(Protocol):
    """What an observation has besides where its noise is known as a bound: a camera's, not an encoder's."""

    @property
    def noise_at_most(self) -> Array:
        """Bound of the standard deviation of each channel's noise, `[m]`; no smaller misfit is more than noise."""
        ...

    def as_left(self, share: Array) -> Observation:
        """The same with less noise, as far as that may be.

        Args:
            share: `[m]` of the noise's variance that a fit leaves.
        """
        ...
