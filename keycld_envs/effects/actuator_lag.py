"""A motor that follows with a lag of first order."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lfilter

from keycld_envs.effects.actuator_saturation import ActuatorSaturation
from keycld_envs.effects.base import Array, Confusable, Effect, parameter
from keycld_envs.effects.native import NativeModel
from keycld_envs.effects.places import LONGEST, ActuatorEffect


@dataclass(frozen=True)
class ActuatorLag(ActuatorEffect):
    """The torque approaches the command with a time constant."""

    id: ClassVar[str] = "actuator_lag"
    equation: ClassVar[str] = "lag*da/dt = u - a"
    phrase: ClassVar[str] = "an actuator lag"
    confusable: ClassVar[Confusable | None] = Confusable("lateness", {"lag": 1.0})

    lag: float = parameter("s", 0.01, low=0.0, high=LONGEST)

    def native(self, model: mujoco.MjModel, later: Sequence[Effect] = ()) -> bool:
        """Of actuators without a memory of their own, which limit commands before they lag."""
        still = model.actuator_dyntype[model.actuator(self.where).id] == mujoco.mjtDyn.mjDYN_NONE
        return bool(still) and not any(isinstance(effect, ActuatorSaturation) for effect in later)

    def write(self, target: NativeModel) -> None:
        """A filter of the actuator."""
        if self.lag > 0:
            kind = "filter" if target.stages and self.lag > target.model.opt.timestep else "filterexact"
            attributes = target.attributes.setdefault(self.where, {})
            attributes |= {"dyntype": kind, "dynprm": repr(float(self.lag))}

    def motor(self, u: Array, h: float) -> Array:
        """Filter; exact for a command that is constant over a step, averaged over the step."""
        if self.lag <= 0:
            return u
        keep = np.exp(-h / self.lag)
        after = lfilter([1 - keep], [1, -keep], u, zi=[keep * u[0]])[0]  # at the ends of the steps
        before = np.concatenate([u[:1], after[:-1]])
        return u + (before - u) * self.lag / h * (1 - keep)
