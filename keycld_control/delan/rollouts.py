"""How far joint models' rollouts are from motions that they have not seen."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from keycld_model.delan import Motions
from keycld_model.delan.measures import steady
from keycld_model.delan.motions import Floats

Hold = Literal["held", "linear"]
SECONDS = 0.5
"""Length of a rollout; each begins where the last one ended. The gates' middle horizon."""


@dataclass(frozen=True)
class Rollouts:
    """Errors of positions over rollouts, in 1e-3 rad or m.

    Attributes:
        median: over rollouts, of the root mean square over times and joints.
        rms: over all; None where one runs away to infinity.
        lost: share of rollouts whose error is beyond the standard deviation of the training positions.
        number: of rollouts.
    """

    median: float | None
    rms: float | None
    lost: float
    number: int


class Rolling(Protocol):
    """What follows a motion: a joint model, or a simulator."""

    def rollout(self, q: Floats, v: Floats, tau: Floats, timestep: float, hold: Hold) -> tuple[Floats, Floats]:
        """Positions and velocities `[T, n]` from a state, under torques `[T, n]`."""
        ...


def rollouts(model: Rolling, motions: Motions, usual: float, seconds: float = SECONDS) -> Rollouts:
    """Follow motions from many of their states under their torques.

    Args:
        model: what is measured.
        motions: that are followed.
        usual: standard deviation of the training positions, root mean square over joints, rad or m.
        seconds: of a rollout.
    """
    errors = np.array([error for motion in motions.motions for error in _errors(model, *steady(motion), seconds)])
    finite = np.where(np.isfinite(errors), errors, np.inf)
    median, rms = 1e3 * float(np.median(finite)), 1e3 * float(np.sqrt(np.mean(finite**2)))
    return Rollouts(
        median if np.isfinite(median) else None,
        rms if np.isfinite(rms) else None,
        float(np.mean(finite > usual)),
        len(errors),
    )


def _errors(model: Rolling, t: Floats, q: Floats, v: Floats, tau: Floats, seconds: float) -> list[float]:
    step = float(t[1] - t[0])
    length = max(1, round(seconds / step))
    found = []
    for start in range(0, len(t) - length, length):
        piece = slice(start, start + length + 1)
        path, _ = model.rollout(q[start], v[start], tau[piece], step, hold="linear")
        found.append(float(np.sqrt(np.mean((path[1:] - q[piece][1:]) ** 2))))
    return found
