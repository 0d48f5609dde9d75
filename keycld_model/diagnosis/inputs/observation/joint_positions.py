"""Joint positions, from encoders or read off images of a camera."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.inputs.observation.checks import check_positions
from keycld_model.diagnosis.inputs.observation.noise import estimate_noise
from keycld_model.diagnosis.inputs.observation.nuisance import Nuisance
from keycld_model.image_alignment.look_errors import LookErrors

Array = NDArray[np.float64]
UNITS = {
    "hinge": {"zero": "rad", "squash": "rad", "skew": "rad", "shutter": "s"},
    "slide": {"zero": "m", "squash": "1", "skew": "1/m", "shutter": "s/m"},
}
"""Units of the errors of a position."""
DEVIATIONS = "standard deviations"
"""Unit of the error of a look's parameter."""
FIRST = 7
"""Samples that tell where a window begins, if no more than as many are missing among them: a parabola goes astray over
a longer gap."""


class JointPositions:
    """One channel per joint; encoders may be off by a constant.

    A camera that looks at the mechanism askew squashes its plane along some direction: to first order angles are off by
    sin 2q ("squash") and cos 2q ("skew"), and slides by q and q². A shutter that rolls across the image sees a joint
    earlier or later by where it is ("shutter"). A look that was fitted, of camera and links, is not quite right either
    ("look"). See `Observation` for the attributes.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        noise: Array | None = None,
        tracked: bool = False,
        criteria: Criteria = STANDARD,
        floor: Array | None = None,
        typical: Array | None = None,
        by_look: LookErrors | None = None,
        noise_at_most: Array | None = None,
    ) -> None:
        """Of all joints of a model.

        Args:
            model: of hinges and slides.
            noise: `[nv]` standard deviation of the sensor, rad or m; None if it is not known yet.
            tracked: positions were read off images, and errors of the camera are refitted, too.
            criteria: how far off sensors may be.
            floor: `[nv]` noise that there is at least, rad or m: what is known of errors that do not scatter from
                sample to sample.
            typical: `[nv]` standard deviation, rad or m, of samples that weigh one; others by their own (`qpos_std` of
                recordings). None where all weigh the same.
            by_look: how far positions are off where the look is with which they were read.
            noise_at_most: `[nv]` bound of the noise, rad or m; by default the noise itself.
        """
        self._by_look = by_look
        self._floor, self._typical = floor, typical
        self._model, self._tracked, self._criteria = model, tracked, criteria
        self._hinges = [bool(kind == mujoco.mjtJoint.mjJNT_HINGE) for kind in model.jnt_type]
        self.names = tuple(model.joint(j).name for j in range(model.njnt))
        self.units = tuple("rad" if hinge else "m" for hinge in self._hinges)
        self.noise: Array = np.full(model.njnt, np.nan) if noise is None else noise
        self.noise_at_most: Array = self.noise if noise_at_most is None else noise_at_most
        self.nuisances = self._errors()

    def _errors(self) -> tuple[Nuisance, ...]:
        """A zero per joint; if positions were tracked, errors of the camera at each joint as well."""
        spreads = self._criteria.spreads
        view = spreads.view if self._by_look is None else spreads.view_beside_look
        camera = {"squash": view, "skew": view, "shutter": spreads.shutter} if self._tracked else {}
        joints = range(len(self.names))
        wanted = [(j, "zero", self._criteria.spreads.zero) for j in joints]
        wanted += [(j, kind, spread) for j in joints for kind, spread in camera.items()]
        of_joints = [
            Nuisance(
                f"{kind} of {self.names[j]}", kind, j, spread, UNITS["hinge" if self._hinges[j] else "slide"][kind]
            )
            for j, kind, spread in wanted
        ]
        look = () if self._by_look is None else self._by_look.parameters
        return (*of_joints, *(Nuisance(f"error of {p.label}", "look", k, 1.0, DEVIATIONS) for k, p in enumerate(look)))

    def calibrated(self, recordings: Sequence[Recording]) -> "JointPositions":
        """With the noise that recordings show.

        Raises:
            InputError: if a joint has too few samples for that.
        """
        times = [np.asarray(recording.t_state) for recording in recordings]
        measured = [self.measured(recording) for recording in recordings]
        noise = estimate_noise(times, measured, [self.weights(recording) for recording in recordings])
        noise = noise if self._floor is None else np.maximum(noise, self._floor)
        return self._with(noise, noise)

    def as_left(self, share: Array) -> "JointPositions":
        """With less noise, if a fit leaves less than positions are said to have that were read off frames."""
        if self._typical is None or share.min() >= 1:
            return self
        return self._with(self.noise * np.sqrt(share.clip(max=1)), self.noise_at_most)

    def _with(self, noise: Array, at_most: Array) -> "JointPositions":
        """The same with another noise."""
        return JointPositions(
            self._model, noise, self._tracked, self._criteria, self._floor, self._typical, self._by_look, at_most
        )

    def check(self, recording: Recording) -> None:
        """Positions of these joints, in rad or m, with few samples missing and no turn left out."""
        check_positions(recording, self._model)

    def measured(self, recording: Recording) -> Array:
        """Positions, rad or m."""
        return np.asarray(recording.qpos, np.float64)

    def weights(self, recording: Recording) -> Array | None:
        """By how well each sample is known, where recordings say so and it is minded."""
        if self._typical is None or recording.qpos_std is None:
            return None
        own = np.asarray(recording.qpos_std, np.float64)
        return np.where(np.isfinite(own), self._typical / own, 1.0)  # missing samples count nowhere

    def positions(self, measured: Array) -> Array:
        """What was measured."""
        return measured

    def initial_state(self, time: Array, measured: Array) -> tuple[Array, Array]:
        """From a parabola through the first samples of each joint, or those of them before a gap."""
        q, v = np.zeros((2, measured.shape[1]))
        for j in range(measured.shape[1]):
            good = np.flatnonzero(np.isfinite(measured[:, j]))[:FIRST]
            near = good[good < good[0] + 2 * FIRST]
            good = near if len(near) > 3 else good
            v[j], q[j] = np.polyfit(time[good], measured[good, j], 2 if len(good) > 3 else 1)[-2:]
        return q, v

    def predict(self, q: Array, v: Array, values: Sequence[float] | Array) -> Array:
        """Positions with the errors of the sensor."""
        out = q.copy()
        with np.errstate(invalid="ignore", over="ignore"):  # of rollouts that fly off
            for nuisance, value in zip(self.nuisances, values, strict=True):
                if nuisance.kind != "look":
                    out[..., nuisance.index] += value * self._error(nuisance, q, v)
            if self._by_look is not None:
                out += self._by_look(q, np.asarray(values)[-len(self._by_look.parameters) :])
        return out

    def _error(self, nuisance: Nuisance, q: Array, v: Array) -> Array | float:
        """How far off positions are per unit of an error."""
        j = nuisance.index
        hinge, at, speed = self._hinges[j], q[..., j], v[..., j]
        if nuisance.kind == "zero":
            return 1.0
        if nuisance.kind == "squash":
            return np.sin(2 * at) if hinge else at
        if nuisance.kind == "skew":
            return np.cos(2 * at) - 1 if hinge else at**2
        return speed * (np.sin(at) if hinge else at)
