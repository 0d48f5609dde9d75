"""A motor that acts late."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Confusable, Effect, parameter
from keycld_envs.effects.native import NativeModel
from keycld_envs.effects.places import LONGEST, ActuatorEffect


@dataclass(frozen=True)
class ActuatorDelay(ActuatorEffect):
    """The command arrives after a dead time."""

    id: ClassVar[str] = "actuator_delay"
    equation: ClassVar[str] = "tau = u(t - d)"
    phrase: ClassVar[str] = "an actuator delay"
    confusable: ClassVar[Confusable | None] = Confusable("lateness", {"d": 1.0})

    d: float = parameter("s", 0.01, low=0.0, high=LONGEST)

    def native(self, model: mujoco.MjModel, later: Sequence[Effect] = ()) -> bool:
        """Of actuators without a delay of their own."""
        return not model.actuator_delay[model.actuator(self.where).id] > 0

    def write(self, target: NativeModel) -> None:
        """A buffer of the actuator; the delay makes up for stages that look ahead."""
        if self.d > 0:
            step = target.model.opt.timestep
            late = float(self.d + (step / 2 if target.stages else 0.0))
            attributes = target.attributes.setdefault(self.where, {})
            attributes |= {"delay": repr(late), "nsample": str(int(np.ceil(late / step)) + 2), "interp": "linear"}

    def motor(self, u: Array, h: float) -> Array:
        """Shift, by fractions of a step as well."""
        whole, part = divmod(self.d / h, 1.0)
        late = np.concatenate([np.full(int(whole) + 1, u[0]), u])
        return (1 - part) * late[1 : len(u) + 1] + part * late[: len(u)]
