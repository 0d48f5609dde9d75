"""Between steps of a simulation and samples of a sensor."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.variant import Variant

Array = NDArray[np.float64]


def observed_times(variant: Variant, t: Array) -> Array:
    """Times of the motion that sensors show at times."""
    for effect in variant.effects:
        t = effect.observe(t)
    return t


def delayed_commands(commands: Sequence[Array], late: Array, windows: Windows) -> Array:
    """What motors get in windows that start a number of steps `[W]` after their own start, `[W, S, nu]`."""
    first = windows.first + late
    whole, part = np.floor(first).astype(int), (first % 1.0)[:, None, None]
    length = np.array([len(u) for u in commands])
    before, last = (np.cumsum(length) - length)[windows.recording], length[windows.recording] - 1
    step = np.clip(whole[:, None] + np.arange(windows.steps + 1), 0, last[:, None])
    out = np.concatenate(commands)[before[:, None] + step]
    return (1 - part) * out[:, :-1] + part * out[:, 1:]


def pulse_forces(variant: Variant, windows: Windows, nv: int) -> Array:
    """Mean forces of pulses over each step, `[W, S, nv]`."""
    out = np.zeros((len(windows), windows.steps, nv))
    edges = windows.start[:, None] + windows.step * np.arange(windows.steps + 1)
    for pulse in variant.pulses:
        of = windows.recording == pulse.recording
        out[of, :, pulse.dof] += np.diff(pulse.impulse(edges[of]), axis=1) / windows.step
    return out


def interpolated(q: Array, v: Array, time: Array, step: float) -> tuple[Array, Array]:
    """Positions and velocities at times `[W, n]` between steps, from those at steps, `[W, S+1, nv]` (Hermite)."""
    k = np.clip((time / step).astype(int), 0, q.shape[1] - 2)
    s = (time / step - k)[..., None]
    row = np.arange(len(q))[:, None]
    q0, q1, v0, v1 = q[row, k], q[row, k + 1], v[row, k] * step, v[row, k + 1] * step
    with np.errstate(invalid="ignore"):  # a rollout that flies off is infinite; whoever asked sees it
        at = (1 + 2 * s) * (1 - s) ** 2 * q0 + s * (1 - s) ** 2 * v0 + s**2 * (3 - 2 * s) * q1 + s**2 * (s - 1) * v1
        return at, ((1 - s) * v0 + s * v1) / step
