"""A motor that is stronger or weaker than thought."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco

from keycld_envs.effects.base import Array, Effect, Kind, parameter
from keycld_envs.effects.native import NativeModel
from keycld_envs.effects.places import ActuatorEffect


@dataclass(frozen=True)
class ActuatorGain(ActuatorEffect):
    """The motor's torque is k times what the simulator believes."""

    id: ClassVar[str] = "actuator_gain"
    equation: ClassVar[str] = "tau = k*u"
    phrase: ClassVar[str] = "an actuator gain"

    k: float = parameter("1", 0.02, low=0.0, absent=1.0)

    def indistinguishable(self, model: mujoco.MjModel) -> tuple[tuple[str, Kind, str], ...]:
        """A link that is heavier by the inverse factor, where there is but one: all but friction is in proportion."""
        if model.njnt == 1 and self.k < 1:
            return (("added_inertia", "body", model.body(int(model.jnt_bodyid[0])).name),)
        return ()

    def native(self, model: mujoco.MjModel, later: Sequence[Effect] = ()) -> bool:
        """Of actuators whose torque is linear in the command."""
        return bool(model.actuator_gaintype[model.actuator(self.where).id] <= int(mujoco.mjtGain.mjGAIN_AFFINE))

    def write(self, target: NativeModel) -> None:
        """A factor of the actuator's gain."""
        target.gains[self.where] = target.gains.get(self.where, 1.0) * self.k

    def motor(self, u: Array, h: float) -> Array:
        """Scale."""
        return self.k * u
