"""What nothing explains along a motion: unknown forces, vibrations and noise, and their covariance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects.edited import torque_per_command
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regressors import resting

Array = NDArray[np.float64]
HELD = 3.0
"""Standard deviation of dry friction at rest over the unknown force there: nearly any force."""


@dataclass(frozen=True)
class Unsteady:
    """Where forces are known worse than elsewhere.

    Attributes:
        rest: `[W, B, nv]` share of each part of a window in which a joint may rest.
        command: `[W, B, nv]` standard deviation of a motor's torque within the part, N m or N; none follows at once.
        held: `[W, B, nv]` standard deviation of dry friction there, since it holds whatever force there is, N m or N.
        noisy: `[W, nv]` mean square of what even unknown forces leave, over that of most windows, at least one: links
            ring where a controller chatters.
    """

    rest: Array
    command: Array
    held: Array
    noisy: Array

    @classmethod
    def of(cls, motion: Motion) -> "Unsteady":
        """Along a motion."""
        torque = motion.u @ torque_per_command(motion.model).T
        squares = motion.over_parts(torque**2) - motion.over_parts(torque) ** 2
        rest = motion.over_parts(resting(motion.v))
        ringing = motion.ringing / np.median(motion.ringing, axis=0)
        held = HELD * rest * np.abs(motion.forces)
        return cls(rest, np.sqrt(np.maximum(squares, 0.0)), held, np.maximum(ringing, 1.0))


@dataclass(frozen=True)
class Discrepancy:
    """What nothing explains.

    Attributes:
        force: `[nv]` standard deviation of unknown forces, N m or N, in each part of a window.
        noise: `[nv]` of the sensors, over those of the motion.
        vibration: `[nv]` of positions, over the noise of the motion: links and mountings give way.
        correlation_time: after which a vibration is another one, s.
        friction: `[nv]` dry friction, which may be any force where a joint rests, N m or N.
        more: `[W, nv]` the same beyond that in some windows.
        share: `[W]` of unknown forces that each window has, which its recording decides: some runs are rougher.
    """

    force: Array
    noise: Array
    vibration: Array
    correlation_time: float
    friction: Array
    more: Array
    share: Array

    def covariance(self, motion: Motion, unsteady: "Unsteady", rows: NDArray[np.int64]) -> Array:
        """Of whitened residuals, `[len(rows), r, r]`.

        Args:
            motion: of W windows.
            unsteady: where forces are known worse.
            rows: some windows.
        """
        response, nv = motion.response[rows], len(self.force)
        friction = (self.friction + self.more[rows])[:, None] * unsteady.rest[rows]
        friction = np.maximum(friction, unsteady.held[rows])
        force = self.force * (self.share[rows][:, None] * np.sqrt(unsteady.noisy[rows]))[:, None]
        spread = np.sqrt(force**2 + friction**2 + unsteady.command[rows] ** 2)
        out = np.zeros((len(rows), response.shape[1], response.shape[1]))
        for j in range(nv):
            scaled = response[:, :, j] * spread[:, None, :, j]
            lasting = response[:, :, j] @ unsteady.held[rows][..., j, None]
            out += scaled @ np.swapaxes(scaled, 1, 2) + lasting @ np.swapaxes(lasting, 1, 2)
        own = np.tile(self.noise**2 * unsteady.noisy[rows], response.shape[1] // nv)
        out[:, np.arange(own.shape[1]), np.arange(own.shape[1])] += own
        time = motion.windows.time[rows]
        alike = np.exp(-np.abs(time[:, :, None] - time[:, None, :]) / self.correlation_time)
        for j in range(nv):
            out[:, j::nv, j::nv] += self.vibration[j] ** 2 * alike
        return out
