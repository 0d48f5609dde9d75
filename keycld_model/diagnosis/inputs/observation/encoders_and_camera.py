"""Joint positions from encoders and from images at once: two channels per joint."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.inputs.observation.checks import check_positions
from keycld_model.diagnosis.inputs.observation.joint_positions import JointPositions
from keycld_model.diagnosis.inputs.observation.noise import estimate_noise
from keycld_model.diagnosis.inputs.observation.nuisance import Nuisance
from keycld_model.image_alignment.look_errors import LookErrors
from keycld_model.turns import on_turns_of

Array = NDArray[np.float64]
SEEN = " (camera)"
"""What the name of a joint ends in where a camera sees it."""


class EncodersAndCamera:
    """The channels of encoders first, then those of a camera; see `Observation` for the attributes.

    The sensors have zeros of their own, and the camera its errors; where both see the same, so do their noises average.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        error: Array,
        noise: Array | None = None,
        criteria: Criteria = STANDARD,
        by_look: LookErrors | None = None,
        noise_at_most: Array | None = None,
    ) -> None:
        """Of all joints of a model.

        Args:
            model: of hinges and slides.
            error: `[nv]` that positions by the camera have at least, rad or m.
            noise: `[2 nv]`, rad or m; None if it is not known yet.
            criteria: how far off sensors may be.
            by_look: how far positions by the camera are off where the look is with which they were read.
            noise_at_most: `[2 nv]` bound of the noise, rad or m; by default the noise itself.
        """
        self._model, self._criteria, self._joints, self._error = model, criteria, model.njnt, error
        self._by_look = by_look
        first, second = (None, None) if noise is None else np.split(noise, 2)
        self._encoders = JointPositions(model, first, criteria=criteria)
        self._camera = JointPositions(model, second, tracked=True, criteria=criteria, by_look=by_look)
        self.names = (*self._encoders.names, *(name + SEEN for name in self._camera.names))
        self.units = self._encoders.units + self._camera.units
        self.noise: Array = np.concatenate([self._encoders.noise, self._camera.noise])
        self.noise_at_most: Array = self.noise if noise_at_most is None else noise_at_most
        self.nuisances: tuple[Nuisance, ...] = self._encoders.nuisances + tuple(
            n if n.kind == "look" else replace(n, name=n.name + SEEN, index=n.index + self._joints)
            for n in self._camera.nuisances
        )

    def calibrated(self, recordings: Sequence[Recording]) -> "EncodersAndCamera":
        """With the noise that recordings show.

        Raises:
            InputError: if a channel has too few samples for that.
        """
        times = [np.asarray(recording.t_state) for recording in recordings]
        noise = estimate_noise(times, [self.measured(recording) for recording in recordings])
        noise[self._joints :] = np.maximum(noise[self._joints :], self._error)
        return EncodersAndCamera(self._model, self._error, noise, self._criteria, self._by_look)

    def as_left(self, share: Array) -> "EncodersAndCamera":
        """With less noise of the camera, if a fit leaves less than is said of it."""
        share = np.where(np.arange(len(share)) < self._joints, 1.0, share)
        if share.min() >= 1:
            return self
        noise = self.noise * np.sqrt(share.clip(max=1))
        return EncodersAndCamera(self._model, self._error, noise, self._criteria, self._by_look, self.noise_at_most)

    def check(self, recording: Recording) -> None:
        """Both halves, as if each were a recording of its own."""
        halves = (self._encoders, slice(self._joints)), (self._camera, slice(self._joints, None))
        for observation, part in halves:
            own = None if recording.qpos is None else np.asarray(recording.qpos)[:, part]
            names = tuple(name.removesuffix(SEEN) for name in recording.joint_names[part])
            units = recording.units.get("qpos", "")
            units = units if isinstance(units, str) else tuple(units)[part]
            observation.check(replace(recording, qpos=own, joint_names=names, units={**recording.units, "qpos": units}))

    def measured(self, recording: Recording) -> Array:
        """Positions by encoders and by the camera, rad or m."""
        return np.asarray(recording.qpos, np.float64)

    def weights(self, recording: Recording) -> None:
        """All alike."""

    def positions(self, measured: Array) -> Array:
        """By the encoders; where they miss a sample, by the camera."""
        encoders, camera = measured[..., : self._joints], measured[..., self._joints :]
        return np.where(np.isfinite(encoders), encoders, camera)

    def initial_state(self, time: Array, measured: Array) -> tuple[Array, Array]:
        """From a parabola through the first seven samples of each joint."""
        return self._encoders.initial_state(time, self.positions(measured))

    def predict(self, q: Array, v: Array, values: Sequence[float] | Array) -> Array:
        """Positions with the errors of both sensors."""
        of_encoders = len(self._encoders.nuisances)
        first = self._encoders.predict(q, v, values[:of_encoders])
        return np.concatenate([first, self._camera.predict(q, v, values[of_encoders:])], axis=-1)


def check_encoders(recording: Recording, model: mujoco.MjModel) -> None:
    """Raise InputError if a recording with frames has no positions by encoders of a model's joints beside them."""
    if recording.qpos is None or recording.t_state is None:
        raise InputError(f"Recording {recording.id!r} has no joint positions beside its frames; use --observe pixels.")
    check_positions(recording, model)


def joined(encoders: Recording, camera: Recording) -> Recording:
    """One recording of both, at the times of the slower sensor; the faster one is interpolated.

    Args:
        encoders: with joint positions by encoders, see `check_encoders`.
        camera: the same run, with those that were read off its images.

    Raises:
        InputError: if the sensors were never on at the same time.
    """
    clocks = [np.asarray(r.t_state, np.float64) for r in (encoders, camera)]
    slow = max(clocks, key=lambda t: float(np.median(np.diff(t))))
    both = slow[(slow >= max(t[0] for t in clocks) - 1e-9) & (slow <= min(t[-1] for t in clocks) + 1e-9)]
    if len(both) < 2:
        raise InputError(f"Recording {encoders.id!r}: encoders and camera were never on at once; check its clocks.")
    known, seen = (_at(both, t, np.asarray(r.qpos)) for t, r in zip(clocks, (encoders, camera), strict=True))
    unit = camera.units["qpos"]
    seen = on_turns_of(known, seen, np.array([u == "rad" for u in unit]))
    return replace(
        camera,
        joint_names=(*camera.joint_names, *(name + SEEN for name in camera.joint_names)),
        units={**camera.units, "qpos": (*unit, *unit)},
        t_state=both,
        qpos=np.concatenate([known, seen], axis=1),
        qpos_std=None,
    )


def _at(times: Array, clock: Array, values: Array) -> Array:
    """Samples `[T, m]` at other times; NaN beside a missing one."""
    if len(clock) == len(times) and np.abs(clock - times).max() < 1e-6:
        return values
    out = np.empty((len(times), values.shape[1]))
    near = np.clip(np.searchsorted(clock, times), 1, len(clock) - 1)
    for j, column in enumerate(values.T):
        there = np.isfinite(column)
        out[:, j] = PchipInterpolator(clock[there], column[there])(times)
        out[~(there[near] & there[near - 1]), j] = np.nan
    return out
