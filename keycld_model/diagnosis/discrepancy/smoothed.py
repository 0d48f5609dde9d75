"""Whole recordings, smoothed: the forces that a simulator would need, at any time, to within what vibrates.

Windows of a motion that is followed begin anywhere, and their free initial states make up for what pushes for as short
a time. Smoothed positions have derivatives throughout, and forces beside them are smoothed alike, so that what is slow
is compared with what is slow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.discrepancy.motion import Motion, inverse_dynamics
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.observation import Observation
from keycld_model.diagnosis.inputs.prepare import spacing
from keycld_model.diagnosis.inputs.ranges import Paths, beyond
from keycld_model.diagnosis.inputs.windows import average_commands
from keycld_model.diagnosis.simulation.simulator import Simulator

Array = NDArray[np.float64]
STEP = 0.01
"""Of the grid of times, s; a third of the smoothing."""
SMOOTHING = 0.03
"""Standard deviation of a Gaussian in time, s: half of what moves with 6 Hz is left; links vibrate with 8 to 12 Hz."""
FINE = 5
"""Times of the grid on which positions are smoothed, per step."""
END = 0.1
"""Time around the ends of a recording, and around gaps, in which smoothed accelerations are guessed in part, s."""


@dataclass(frozen=True)
class Smoothed(Motion):
    """Motion of W whole recordings, each one window; the shorter ones rest at their ends.

    What a force is an answer to is the force that the motion needs beyond the motors': residuals are forces,
    `[W, S nv]`, N m or N.

    Attributes:
        smoothing: standard deviation of the Gaussian, s.
        inside: `[W, S]` where there is a recording, and its motion is known.
    """

    smoothing: float
    inside: NDArray[np.bool_]

    @classmethod
    def whole(cls, motion: Motion) -> "Smoothed":
        """Of the recordings of a motion that was followed in windows."""
        recordings, observation, model = motion.windows.recordings, motion.windows.observation, motion.model
        smoothing = max(SMOOTHING, 1.5 * spacing(recordings))
        clocks = [np.asarray(r.t_state, dtype=np.float64) for r in recordings]
        seconds = [float(t[-1] - t[0]) for t in clocks]
        steps = max(int(s / STEP) for s in seconds)
        path = np.stack([_positions(r, observation, steps, smoothing) for r in recordings])
        speed = np.gradient(path, STEP, axis=1)
        q, v, a = (_middle(x) for x in (path, speed, np.gradient(speed, STEP, axis=1)))
        edges: Array = STEP * np.arange(steps + 1, dtype=np.float64)
        commands = tuple(average_commands(r, t[0] + edges) for r, t in zip(recordings, clocks, strict=True))
        u, time, w = np.stack(commands), np.tile(edges[:-1] + STEP / 2, (len(q), 1)), len(q)
        windows = replace(
            motion.windows,
            step=STEP,
            commands=commands,
            recording=np.arange(w),
            first=np.zeros(w, dtype=np.int64),
            start=np.array([t[0] for t in clocks]),
            time=np.zeros((w, 0)),
            measured=np.zeros((w, 0, model.nv)),
            steps=steps,
        )
        required, none = inverse_dynamics(model, q, v, a), np.zeros((w, 0, model.nv))
        problem = Problem(Simulator(model, STEP, criteria=motion.problem.criteria), windows)
        inside = np.stack([_known(r, observation, t, smoothing) for r, t in zip(recordings, time, strict=True)])
        arrays = q, v, a, u, time, (path, speed), required, none, none, none[..., 0], none
        whole = cls(problem, motion.noise, *arrays, smoothing, inside)
        return replace(whole, residual=whole.answer(required - _of_motors(model, q, v, u)))

    @property
    def vibrating(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Smoothed velocities, `[W, S, nv]`."""
        return self.v

    def smooth(self, values: Array) -> Array:
        """Values `[W, S, ...]` smoothed as positions are."""
        return gaussian_filter1d(np.nan_to_num(values), self.smoothing / STEP, axis=1, mode="nearest")

    def answer(self, forces: Array) -> Array:
        """Smoothed forces, `[W, S nv]`."""
        return self.smooth(forces).reshape(len(forces), -1)

    def answer_by_step(self, forces: Array) -> Array:
        """The same."""
        return self.answer(forces)


def _middle(x: Array) -> Array:
    """Of the steps, `[W, S, nv]`, of values at their ends."""
    return (x[:, 1:] + x[:, :-1]) / 2


def _positions(recording: Recording, observation: Observation, steps: int, smoothing: float) -> Array:
    """Smoothed positions at the ends of steps, `[steps + 1, nv]`; the last one stays beyond the recording's end."""
    t, q = np.asarray(recording.t_state), observation.positions(observation.measured(recording))
    own = int((t[-1] - t[0]) / STEP)
    fine = t[0] + STEP / FINE * np.arange(own * FINE + 1)
    there = [np.isfinite(column) for column in q.T]
    even = np.stack([np.interp(fine, t[ok], column[ok]) for ok, column in zip(there, q.T, strict=True)], axis=1)
    sigma = smoothing / STEP * FINE
    k = min(int(4 * sigma), len(even) - 1)
    turned = np.concatenate([2 * even[:1] - even[k:0:-1], even, 2 * even[-1:] - even[-2 : -k - 2 : -1]])
    smooth = gaussian_filter1d(turned, sigma, axis=0, mode="nearest")[k : len(turned) - k : FINE]
    return np.concatenate([smooth, np.repeat(smooth[-1:], steps - own, axis=0)])


def _known(recording: Recording, observation: Observation, time: Array, smoothing: float) -> NDArray[np.bool_]:
    """Where times since the start, `[S]`, are within a recording and away from its ends and gaps."""
    t = np.asarray(recording.t_state)
    there = t[np.isfinite(observation.measured(recording)).all(axis=1)] - t[0]
    gaps = np.flatnonzero(np.diff(there) > 2 * smoothing)
    begins = np.concatenate([[-np.inf], there[gaps], there[-1:]])
    ends = np.concatenate([there[:1], there[gaps + 1], [np.inf]])
    near = (time[:, None] > begins - END) & (time[:, None] < ends + END)
    return ~np.any(near, axis=1)


def _of_motors(model: mujoco.MjModel, q: Array, v: Array, u: Array) -> Array:
    """Generalised forces of the motors, `[W, S, nv]`, N m or N."""
    data, out = mujoco.MjData(model), np.zeros_like(v)
    for at in np.ndindex(v.shape[:-1]):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[at], v[at], u[at]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        out[at] = data.qfrc_actuator
    return out


def within_range(motion: Smoothed, rows: Sequence[int], known: Sequence[int]) -> NDArray[np.bool_]:
    """Where some recordings are at positions and speeds that the known ones have, too, `[len(rows), S]`.

    Forces that nobody modelled are unknown beyond.
    """
    was, inside = list(known), motion.inside[list(known)]
    paths = Paths(*(x[was][inside][None] for x in (motion.q, motion.v, motion.u)))
    own = Paths(*(x[list(rows)] for x in (motion.q, motion.v, motion.u)))
    channels = beyond(motion.model, paths, own)
    outside = np.any([b for channel, b in channels.items() if not channel.startswith("command")], axis=0)
    return motion.inside[list(rows)] & ~outside
