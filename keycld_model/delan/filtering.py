"""Signals below a band, for robots whose links vibrate: accelerations of a vibration are none of the joints.

Positions, velocities, accelerations and torques go through the same filter without a delay, and as few samples stay as
the band needs (parallel filtering and decimation; Gautier, 1997; Swevers, Verdonck and De Schutter, 2007). Without it,
least squares take a vibration's accelerations for the joints', and masses are too small.
"""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from keycld_envs.errors import InputError
from keycld_model.delan.motions import Floats, Motion

ORDER = 3
"""Of the Butterworth filter, which is run forwards and backwards."""
PER_BAND = 4.0
"""Samples that stay, per period of the band's edge: what the filter leaves at half their rate is below 2 %."""
PERIODS = 4.0
"""Periods of the band's edge that a motion must last at least: at each end, the filter is uncertain for one, which is
left out."""


def low_pass(where: str, id: str, t: Floats, q: Floats, v: Floats | None, tau: Floats, band: float) -> Motion:
    """A motion below a band, on a steady clock.

    What the filter takes away of measured velocities (positions, if there are none) counts as white noise; standard
    deviations of what is differentiated follow from it.

    Args:
        where: the motion, for messages.
        id: its name.
        t: `[T]`, s, increasing.
        q: `[T, n]` measured positions; NaN where one is missing.
        v: `[T, n]` measured velocities, if any.
        tau: `[T, n]` torques.
        band: Hz, at which the filter halves amplitudes.

    Raises:
        InputError: if the motion is too short, or has too few samples per second.
    """
    if not (np.isfinite(band) and band > 0):
        raise InputError(f"The band is {band:g} Hz; it must be positive.")
    seconds, rate = t[-1] - t[0], (len(t) - 1) / max(t[-1] - t[0], 1e-12)
    if seconds < PERIODS / band or rate < PER_BAND * band:
        raise InputError(
            f"{where} has {rate:.3g} samples/s for {seconds:.3g} s; a band of {band:g} Hz needs "
            f"{PER_BAND * band:.3g} samples/s for {PERIODS / band:.3g} s, so leave it out, or choose another band."
        )
    clock = t[0] + np.arange(len(t)) / rate
    sections = butter(ORDER, band, fs=rate, output="sos")

    def slope(x: Floats) -> Floats:
        return CubicSpline(clock, x)(clock, 1)

    def below(x: Floats) -> Floats:
        return sosfiltfilt(sections, x, axis=0)

    def steady(x: Floats) -> Floats:
        return np.stack([np.interp(clock, t[np.isfinite(c)], c[np.isfinite(c)]) for c in x.T], axis=1)

    impulse = np.zeros((len(clock), 1))
    impulse[len(clock) // 2] = 1.0
    gains, response = [], below(impulse)
    for _ in range(2):
        response = slope(response)
        gains.append(float(np.linalg.norm(response)))
    measured = steady(q if v is None else v)
    noise = np.std(measured - below(measured), axis=0) * np.ones_like(measured)
    low_q = below(steady(q))
    low_v = slope(low_q) if v is None else below(measured)
    stds = (gains[0] * noise, gains[1] * noise) if v is None else (np.zeros_like(noise), gains[0] * noise)
    motion = Motion(id, clock, low_q, low_v, slope(low_v), below(steady(tau)), *stds)
    ends = int(rate / band)
    return motion.part(slice(ends, len(clock) - ends, max(1, int(rate / (PER_BAND * band)))), id)
