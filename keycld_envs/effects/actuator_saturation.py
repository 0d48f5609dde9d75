"""A motor that cannot give more than so much."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Effect, Seen, parameter
from keycld_envs.effects.native import NativeModel
from keycld_envs.effects.places import ActuatorEffect

LIMITS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85)
"""Shares of the greatest command that a search starts from."""


@dataclass(frozen=True)
class ActuatorSaturation(ActuatorEffect):
    """Commands beyond the limit are cut."""

    id: ClassVar[str] = "actuator_saturation"
    equation: ClassVar[str] = "tau = clip(u, -s, s)"

    s: float = parameter("command", 0.05, low=0.0, grid=(0.5,))

    def grids(self, model: mujoco.MjModel, seen: Seen) -> dict[str, tuple[float, ...]]:
        """Shares of the greatest command."""
        most = float(seen.command[model.actuator(self.where).id])
        return {"s": tuple(share * most for share in LIMITS)}

    def native(self, model: mujoco.MjModel, later: Sequence[Effect] = ()) -> bool:
        """Always."""
        return True

    def write(self, target: NativeModel) -> None:
        """Limits of the command, which come before gains that are written already."""
        model, i = target.model, target.model.actuator(self.where).id
        low, high = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
        limit = self.s / max(target.gains.get(self.where, 1.0), 1e-9)
        model.actuator_ctrlrange[i], model.actuator_ctrllimited[i] = (max(low, -limit), min(high, limit)), 1

    def motor(self, u: Array, h: float) -> Array:
        """Clip."""
        return np.clip(u, -self.s, self.s)
