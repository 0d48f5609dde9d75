"""How the mechanisms are moved: released, driven by commands drawn in advance, or by a noisy controller."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.blind.mechanism import Array
from keycld_control.benchmarks.blind.plant import Controller
from keycld_control.benchmarks.blind.sites import Site, sites
from keycld_envs.systems import get_system

Excitation = Literal["passive", "open_loop", "closed_loop", "weak", "mixed"]
EXCITATIONS: tuple[Excitation, ...] = ("passive", "open_loop", "closed_loop", "weak", "mixed")
WEAK = 0.1
"""Share of the usual commands that weak ones are: too little for them to tell masses from forces."""
LIMIT = 3.0
"""Greatest command, which is that of the environments."""


@dataclass(frozen=True)
class Drive:
    """How one recording starts, and its commands.

    Attributes:
        q: `[nv]` positions to start from, rad or m.
        v: `[nv]` velocities to start from, rad/s or m/s.
        controller: gives the commands at ticks; it has a memory, so that a drive is for one run.
    """

    q: Array
    v: Array
    controller: Controller


def drive(
    system: str,
    excitation: Excitation,
    level: float,
    smooth: bool,
    times: Array,
    noise: Array,
    zero: Array,
    rng: np.random.Generator,
) -> Drive:
    """Draw the start and the commands of a recording.

    Args:
        system: short name.
        excitation: released, driven in open loop, as usual or weakly, or by a position controller.
        level: factor of all amplitudes, about one.
        smooth: sums of sines instead of steps.
        times: `[ticks]` when commands may change, s.
        noise: `[nv]` standard deviation of the sensors, rad or m.
        zero: `[nv]` zeros of the encoders, rad or m.
        rng: random numbers.
    """
    joints, rest = sites(system), np.array(get_system(system).hanging_qpos)
    nv, command = len(joints), np.array([s.command for s in joints])
    hold = {"closed_loop": 0.4, "open_loop": 0.5}.get(excitation, 1.0)
    release = np.array([s.release for s in joints]) * level
    q = rest + release * (hold * rng.choice([-1, 1], nv) * rng.uniform(0.4, 1.0, nv))
    v = rng.normal(0, 0.5 * level, nv)
    if excitation == "passive":
        return Drive(q, v, _released(nv))
    if excitation in ("open_loop", "weak"):
        usual = command * (WEAK if excitation == "weak" else 1.0)
        table = (_sines if smooth else _steps)(times, usual * level, rng)
        return Drive(q, v, _from_table(np.clip(table, -LIMIT, LIMIT)))
    goals = rest + (_sines if smooth else _long_steps)(times, np.array([s.target for s in joints]) * level, rng)
    dither = _steps(times, 0.25 * command, rng)
    readings = rng.normal(0, noise, (len(times), nv)) + zero
    return Drive(q, v, _position_controller(joints, times, goals, dither, readings))


def _released(size: int) -> Controller:
    still = np.zeros(size)
    return lambda tick, q: still


def _from_table(table: Array) -> Controller:
    return lambda tick, q: table[tick]


def _position_controller(
    joints: Sequence[Site], times: Array, goals: Array, dither: Array, readings: Array
) -> Controller:
    """Proportional-derivative control, with the speed from filtered differences of noisy readings."""
    stiffness, damping = (np.array([getattr(s, key) for s in joints]) for key in ("stiffness", "damping"))
    last, speed = np.empty(0), np.zeros(goals.shape[1])

    def command(tick: int, q: Array) -> Array:
        nonlocal last, speed
        y = q + readings[tick]
        if len(last):
            step = float(times[tick] - times[tick - 1])
            share = step / (step + 0.02)
            speed = speed + share * ((y - last) / step - speed)
        last = y
        return np.clip(stiffness * (goals[tick] - y) - damping * speed + dither[tick], -LIMIT, LIMIT)

    return command


def _held(shortest: float, longest: float) -> Callable[[Array, Array, np.random.Generator], Array]:
    def draw(times: Array, size: Array, rng: np.random.Generator) -> Array:
        out = np.empty((len(times), len(size)))
        for j, amplitude in enumerate(size):
            edges = np.cumsum(rng.uniform(shortest, longest, int(times[-1] / shortest) + 2))
            values = rng.uniform(-amplitude, amplitude, len(edges) + 1)
            out[:, j] = values[np.searchsorted(edges, times, side="right")]
        return out

    return draw


_steps, _long_steps = _held(0.1, 0.4), _held(0.6, 1.4)


def _sines(times: Array, size: Array, rng: np.random.Generator) -> Array:
    """Five sines between .2 and 3 Hz, of equal size in the mean square."""
    rate = 2 * np.pi * np.exp(rng.uniform(np.log(0.2), np.log(3.0), (5, 1, len(size))))
    phase = rng.uniform(0, 2 * np.pi, rate.shape)
    return np.sin(rate * times[:, None] + phase).sum(axis=0) * size / np.sqrt(7.5)


def ticks_and_times(
    rate: float, seconds: float, jitter: bool, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Array]:
    """The milliseconds at which commands change, and the times of samples, s; with jitter neither is regular."""
    number, period = round(rate * seconds), 1 / rate
    times: Array = np.arange(number, dtype=np.float64) * period
    ticks = np.round(times * 1e3).astype(np.int64)
    if jitter:
        ticks[1:] += rng.integers(-1, 2, number - 1)
        times = np.clip(times + rng.uniform(-0.12, 0.12, number) * period, 0.0, None)
    return ticks, times
