"""Bells in time that stand out of forces that nothing explains (matched filters; North, 1943)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from keycld_model.diagnosis.discrepancy.smoothed import STEP

Array = NDArray[np.float64]
DURATIONS = (0.24, 0.36, 0.52)
"""Of pushes, s: four standard deviations of the bell; a hand takes a quarter to half a second."""
SEEN = 0.6
"""Share of a bell's energy that must be within the recording."""


@dataclass(frozen=True)
class Standing:
    """How bells stand out in a recording, for each of D durations.

    Attributes:
        score: `[D, S, nv]` of a bell in the middle of each step.
        height: `[D, S, nv]` of it, N m or N.
        gain: `[D, S, nv]` fall of the weighted sum of squares with it.
        left: `[S, nv]` forces that nothing explains.
    """

    score: Array
    height: Array
    gain: Array
    left: Array

    @property
    def most(self) -> Array:
        """`[D, nv]` of all times."""
        return np.abs(self.score).max(axis=1)


def standing(left: Array, spread: Array, known: NDArray[np.bool_]) -> Standing:
    """Bells fitted by least squares around every time, over the spread of a force that is as slow.

    A recording that all in all leaves more than expected counts for less; what stands out does not count in that.

    Args:
        left: `[S, nv]` forces that nothing explains.
        spread: `[S, nv]` expected of them.
        known: `[S]` where both are known.
    """
    weight = known[:, None] / spread**2
    scores, heights, gains = [], [], []
    for duration in DURATIONS:
        t = np.arange(-round(0.75 * duration / STEP), round(0.75 * duration / STEP) + 1) * STEP
        bell = np.exp(-0.5 * (4 * t / duration) ** 2)[:, None]
        energy = np.maximum(fftconvolve(weight, bell**2, "same", axes=0), max(1e-9 * weight.max(), 1e-300))
        height = fftconvolve(weight * left, bell, "same", axes=0) / energy
        deviation = fftconvolve(weight * spread, bell, "same", axes=0) / energy
        seen = fftconvolve(known[:, None].astype(float), bell**2, "same", axes=0) > SEEN * (bell**2).sum()
        scores.append(np.where(seen, height / np.maximum(deviation, 1e-12), 0.0))
        heights.append(height)
        gains.append(height**2 * energy)
    whole = np.sqrt(np.mean(np.minimum((left / spread)[known] ** 2, 1.0), axis=0)) if known.any() else 1.0
    return Standing(np.array(scores) / whole, np.array(heights), np.array(gains), left)
