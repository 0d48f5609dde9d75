"""What a motor is told in an experiment."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Drive:
    """Commands of one motor over time; of a release, none.

    Attributes:
        shape: "none", "sine" from zero, or "steps", uniform at random and always the same.
        size: amplitude of the sine, or bound of the steps, in the motor's unit.
        hz: of the sine, or number of steps per second.
    """

    shape: Literal["none", "sine", "steps"] = "none"
    size: float = 0.0
    hz: float = 0.0

    def commands(self, time: Array) -> Array:
        """Commands `[n]` at times `[n]`, s from the start."""
        if self.shape == "none":
            return np.zeros(len(time))
        if self.shape == "sine":
            return self.size * np.sin(2 * np.pi * self.hz * time)
        step = np.floor(self.hz * time + 1e-9).astype(int)
        return self.size * np.random.default_rng(0).uniform(-1, 1, int(step.max()) + 1)[step]

    def __str__(self) -> str:
        """As a phrase."""
        if self.shape == "none":
            return "nothing"
        what = f"a sine of {self.hz:g} Hz" if self.shape == "sine" else f"random steps every {1 / self.hz:g} s"
        return f"{what} up to {self.size:.2g}"
