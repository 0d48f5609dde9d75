"""Recordings cut into short pieces, each with a start of its own, so that errors do not pile up."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.inputs.observation.protocol import Observation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Windows:
    """W pieces of n samples and S steps of the simulation, which start at a step of their recording's grid.

    Attributes:
        recordings: they are cut from.
        observation: of them.
        step: seconds per step of the simulation.
        commands: per recording, commands `[N, nu]` averaged over the steps of its grid.
        speeds: per recording, roughly, velocities `[N, nv]` in the middle of those steps.
        recording: `[W]` index of the recording.
        first: `[W]` index of the first step in the recording's grid.
        start: `[W]` time of that step, s.
        time: `[W, n]` times of the samples, s.
        measured: `[W, n, m]` what the sensor showed; NaN where missing.
        weight: `[W, n, m]` noise of the channel over that of the sample.
        steps: S.
    """

    recordings: tuple[Recording, ...]
    observation: Observation
    step: float
    commands: tuple[Array, ...]
    speeds: tuple[Array, ...]
    recording: NDArray[np.int64]
    first: NDArray[np.int64]
    start: Array
    time: Array
    measured: Array
    weight: Array
    steps: int

    def __len__(self) -> int:
        return len(self.start)

    @property
    def samples(self) -> int:
        """Samples per window, n."""
        return self.time.shape[1]

    @property
    def ids(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(recording.id for recording in self.recordings)

    @property
    def begun(self) -> Array:
        """`[W]` seconds from the start of the recording to that of the window: clocks may count from any time."""
        return (self.first * self.step).astype(np.float64)

    @property
    def end(self) -> Array:
        """`[W]` time of the last step, s."""
        return self.start + self.steps * self.step

    def edges(self, parts: int) -> NDArray[np.int64]:
        """Steps `[parts + 1]` between equal parts of a window."""
        return np.linspace(0, self.steps, parts + 1).round().astype(int)

    def take(self, index: NDArray[np.int64]) -> "Windows":
        """Some of the windows."""
        per_window = ("recording", "first", "start", "time", "measured", "weight")
        return replace(self, **{name: getattr(self, name)[index] for name in per_window})

    def evenly(self, number: int) -> NDArray[np.int64]:
        """Indices of a number of windows at most, spread over all of them."""
        if len(self) <= number:
            return np.arange(len(self))
        return np.linspace(0, len(self) - 1, number).round().astype(int)

    def recut(self, step: float | None = None, samples: int | None = None) -> "Windows":
        """All windows of the recordings, for another step of the simulation, or of another number of samples."""
        return cut(self.recordings, self.observation, step or self.step, samples or self.samples)

    def halved(self) -> "Windows":
        """The same windows with steps half as long."""
        fine = self.recut(step=self.step / 2)
        same = {"commands": fine.commands, "speeds": fine.speeds}
        return replace(self, step=self.step / 2, first=2 * self.first, steps=2 * self.steps, **same)

    def shorter(self, parts: int) -> "Windows":
        """Each window cut into a number of parts."""
        samples = self.samples // parts
        pieces = [slice(k * samples, (k + 1) * samples) for k in range(parts)]
        cut_up = (self.time, self.measured, self.weight)
        time, measured, weight = (np.concatenate([x[:, p] for p in pieces]) for x in cut_up)
        recording, first, start = (np.tile(x, parts) for x in (self.recording, self.first, self.start))
        skipped = _steps_before(time[:, 0] - start, self.step)
        start = start + skipped * self.step
        whole = replace(
            self,
            recording=recording,
            first=first + skipped,
            start=start,
            time=time,
            measured=measured,
            weight=weight,
            steps=_steps_over(time, start, self.step),
        )
        return whole.take(np.flatnonzero(_enough(measured)))

    def initial_states(self) -> tuple[Array, Array]:
        """Positions and velocities `[W, nv]` at the starts, as the first samples tell them."""
        states = [
            self.observation.initial_state(time - start, measured)
            for time, start, measured in zip(self.time, self.start, self.measured, strict=True)
        ]
        q, v = zip(*states, strict=True)
        return np.array(q), np.array(v)


def cut(recordings: Sequence[Recording], observation: Observation, step: float, samples: int) -> Windows:
    """Cut recordings into windows of a number of samples; what is left at the end of a recording is dropped.

    Windows begin with a sample that is there; with too few that are, or with a pause, they are dropped as well.

    Args:
        recordings: with commands for all motors, or none.
        observation: what is measured in them.
        step: of the simulation, s.
        samples: per window.

    Raises:
        InputError: if no window is left.
    """
    commands, speeds, rows = [], [], []
    for index, recording in enumerate(recordings):
        t, measured, weight = (
            np.asarray(recording.t_state),
            observation.measured(recording),
            observation.weights(recording),
        )
        weight = np.ones(measured.shape) if weight is None else weight
        origin = t[0]
        grid = int(np.ceil((t[-1] - origin) / step)) + 2
        edges = origin + step * np.arange(grid + 1)
        commands.append(average_commands(recording, edges))
        speeds.append(_speeds(t, observation.positions(measured), (edges[1:] + edges[:-1]) / 2))
        longest = 5 * samples * np.median(np.diff(t))  # what lasts longer holds a pause
        for i in _starts(measured, samples):
            first = _steps_before(t[i] - origin, step)
            piece = slice(i, i + samples)
            if _enough(measured[piece]) and t[i + samples - 1] - t[i] < longest:
                rows.append((index, first, origin + first * step, t[piece], measured[piece], weight[piece]))
    if not rows:
        names = ", ".join(repr(recording.id) for recording in recordings)
        raise InputError(
            f"The recordings {names} have no {samples} samples in a row without a pause, half of them finite; record "
            "for longer."
        )
    columns = (np.array(column) for column in zip(*rows, strict=True))
    recording, first, start, time, shown, weights = columns
    steps = _steps_over(time, start, step)
    return Windows(
        tuple(recordings),
        observation,
        step,
        tuple(commands),
        tuple(speeds),
        recording,
        first,
        start,
        time,
        shown,
        weights,
        steps,
    )


def _steps_before(seconds: Array | float, step: float) -> NDArray[np.int64]:
    """Whole steps that end within a time."""
    return np.floor(np.asarray(seconds) / step + 1e-4).astype(int)  # clocks may have large numbers, and few digits left


def _steps_over(time: Array, start: Array, step: float) -> int:
    """Steps that windows need to reach their last samples, times `[W, n]` and `[W]`."""
    return int(np.ceil((time[:, -1] - start).max() / step)) + 1


def _starts(measured: Array, samples: int) -> list[int]:
    """Indices of the first samples of windows, one after the other, of `[n, m]`; none begins with what is missing."""
    there, out = np.flatnonzero(np.isfinite(measured).any(axis=1)), []
    while len(there) and there[0] <= len(measured) - samples:
        out.append(int(there[0]))
        there = there[there >= there[0] + samples]
    return out


def _enough(measured: Array) -> NDArray[np.bool_]:
    """Whether enough samples `[..., n, m]` of every channel are there."""
    return (np.isfinite(measured).sum(axis=-2) >= max(4, measured.shape[-2] // 2)).all(axis=-1)


def _speeds(t: Array, q: Array, times: Array) -> Array:
    """Velocities `[len(times), nv]` from positions `[n, nv]`, by local parabolas (Savitzky and Golay, 1964)."""
    even, width = np.linspace(t[0], t[-1], len(t)), 7
    out = np.empty((len(times), q.shape[1]))
    for j, column in enumerate(q.T):
        good = np.isfinite(column)
        smooth = np.interp(even, t[good], column[good])
        if len(even) >= width:
            slope = np.asarray(savgol_filter(smooth, width, 2, deriv=1, delta=float(even[1] - even[0])), dtype=float)
        else:
            slope = np.gradient(smooth, even)
        out[:, j] = np.interp(times, even, slope)
    return out


def average_commands(recording: Recording, edges: Array) -> Array:
    """Commands `[len(edges) - 1, nu]`, held from each to the next as recorded, averaged between the edges."""
    if recording.action is None or recording.t_action is None or not len(recording.t_action):
        return np.zeros((len(edges) - 1, len(recording.actuator_names)))
    t, u = recording.t_action, recording.action
    held = np.concatenate([np.zeros((1, u.shape[1])), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 1)
    integral = held[k] + u[k] * (edges - t[k])[:, None]  # before the first command, the first
    return np.diff(integral, axis=0) / np.diff(edges)[:, None]
