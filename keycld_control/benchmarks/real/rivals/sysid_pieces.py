"""Short pieces of recordings as mujoco.sysid takes them: initial states, positions, and commands that may be late."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from keycld_control.benchmarks.real.rivals.deviations import Array
from keycld_control.benchmarks.refitting import accurate_step, average_commands, thin
from keycld_envs.recordings import Recording

SECONDS = 0.4
"""Length of a piece; initial states are not fitted, and their errors grow with it."""
MOST = 40
"""Pieces of a set, evenly chosen where there are more."""
SMOOTH = 0.06
"""Seconds of the cubic polynomials that give initial states (Savitzky and Golay, 1964)."""


@dataclass(frozen=True)
class Pieces:
    """Pieces of equal length, on even grids.

    Attributes:
        step: between samples, s.
        recordings: of each piece.
        times: `[N, T]` of its samples.
        q: `[N, T, nq]` measured positions.
        start: `[N, 2 nq]` positions and velocities at the start.
        actuators: names of the motors.
    """

    step: float
    recordings: Sequence[Recording]
    times: Array
    q: Array
    start: Array
    actuators: Sequence[str]

    @classmethod
    def of(cls, recordings: Sequence[Recording], model: mujoco.MjModel) -> "Pieces":
        """Recordings cut into pieces."""
        step = accurate_step([thin(r) for r in recordings])
        length = round(SECONDS / step) + 1
        source, times, q, start = [], [], [], []
        for recording in recordings:
            grid, positions, states = _smoothed(recording, step)
            for k in range(0, len(grid) - length + 1, length - 1):
                source.append(recording)
                times.append(grid[k : k + length])
                q.append(positions[k : k + length])
                start.append(states[k])
        some = np.unique(np.linspace(0, len(times) - 1, MOST).round().astype(int))
        source, times, q, start = ([part[i] for i in some] for part in (source, times, q, start))
        names = [model.actuator(i).name for i in range(model.nu)]
        return cls(step, source, np.array(times), np.array(q), np.array(start), names)

    def commands(self, delays: Array) -> Array:
        """Mean commands `[N, T, nu]` from each sample to the next, with each motor late by so many seconds."""
        return np.array([self._late(n, delays) for n in range(len(self.times))])

    def _late(self, n: int, delays: Array) -> Array:
        edges = np.append(self.times[n], self.times[n, -1] + self.step)
        columns = [average_commands(self.recordings[n], edges - late)[:, i] for i, late in enumerate(delays)]
        return np.stack(columns, axis=1)

    def trajectories(self, toolbox: Any, model: mujoco.MjModel) -> list[Any]:
        """As mujoco.sysid's `SystemTrajectory`."""
        nq, out = model.nq, []
        for times, q, start, u in zip(
            self.times, self.q, self.start, self.commands(np.zeros(len(self.actuators))), strict=True
        ):
            state = toolbox.create_initial_state(model, start[:nq], start[nq:])
            since = times - times[0]
            control, measured = toolbox.TimeSeries(since, u), toolbox.TimeSeries(since[1:], q[1:])
            out.append(toolbox.SystemTrajectory(model, control, measured, state, None))
        return out

    def rollout(
        self,
        toolbox: Any,
        held: Mapping[str, float],
        *,
        control_signal: Sequence[Any],
        param_dicts: Sequence[Any],
        initial_states: Sequence[Array],
        models: Sequence[mujoco.MjModel],
        **given: Any,
    ) -> Any:
        """mujoco.sysid's rollouts, with late commands, from positions without the zeros of encoders."""
        late: dict[bytes, Array] = {}
        told, begun = [], np.array(initial_states)
        for parameters in param_dicts:
            delays = np.array([_value(parameters, f"actuator_delay at {name}") for name in self.actuators])
            if delays.tobytes() not in late:
                late[delays.tobytes()] = self.commands(delays)
            commands = late[delays.tobytes()]
            told += [toolbox.TimeSeries(c.times, u) for c, u in zip(control_signal, commands, strict=False)]
        zeros = np.array([self._zeros(models[0], parameters, held) for parameters in param_dicts])
        begun[:, 1 : 1 + models[0].nq] -= np.repeat(zeros, len(self.times), axis=0)
        return toolbox.sysid_rollout(control_signal=told, initial_states=begun, models=models, **given)

    def residual(
        self,
        held: Mapping[str, float],
        parameters: Any,
        predicted: Any,
        measured: Any,
        model: mujoco.MjModel,
        *_: Any,
        state: Array,
        **__: Any,
    ) -> tuple[Array, Any, Any]:
        """Measured less predicted positions `[T - 1, nq]`, with zeros of encoders."""
        zero = self._zeros(model, parameters, held)
        return measured.data - zero - state[:, 1 : 1 + model.nq], measured, measured

    def _zeros(self, model: mujoco.MjModel, parameters: Any, held: Mapping[str, float]) -> Array:
        names = [f"encoder_zero at {model.joint(j).name}" for j in range(model.njnt)]
        return np.array([_value(parameters, name, held.get(name, 0.0)) for name in names])

    def together(self, flat: Array, x: Array) -> Array:
        """Residuals of all pieces one after another, `[N (T - 1) nq]`, or with a column for each of several `x`."""
        if x.ndim == 1:
            return flat
        return flat.reshape(flat.shape[0], x.shape[1], -1).transpose(2, 0, 1).reshape(-1, x.shape[1])


def _value(parameters: Any, name: str, otherwise: float = 0.0) -> float:
    return float(parameters[name].value[0]) if name in parameters else otherwise


def _smoothed(recording: Recording, step: float) -> tuple[Array, Array, Array]:
    """Times on an even grid, positions there, and smoothed positions and velocities."""
    t, measured = np.asarray(recording.t_state), np.asarray(recording.qpos, np.float64)
    fine = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], fine)
    q = np.stack([np.interp(even, t[np.isfinite(y)], y[np.isfinite(y)]) for y in measured.T], axis=1)
    width = max(5, 2 * round(SMOOTH / fine / 2) + 1)
    smooth, speed = (np.asarray(savgol_filter(q, width, 3, deriv=d, delta=fine, axis=0), float) for d in (0, 1))
    grid = np.arange(t[0], t[-1], step)
    at = [np.stack([np.interp(grid, even, y) for y in z.T], axis=1) for z in (q, smooth, speed)]
    return grid, at[0], np.concatenate(at[1:], axis=1)
