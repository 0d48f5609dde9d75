"""Friction of a gear, in proportion to the torque that it transmits."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Self

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Confusable, parameter
from keycld_envs.effects.edited import actuator_torque
from keycld_envs.effects.functions import functions, smooth_sign
from keycld_envs.effects.places import ActuatorEffect


@dataclass(frozen=True)
class GearFriction(ActuatorEffect):
    """Friction between the teeth of a gear: of the motor's torque a share mu is lost (Duclusaud et al., 2024).

    Only of motors whose torque falls with speed, as that of an electric motor does before its gear; where a simulator
    is told the torque itself, that is taken for what comes out of the gear.
    """

    id: ClassVar[str] = "load_dependent_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -mu*|tau_motor|*sign(qd)"
    at_joint: ClassVar[bool] = True
    program: ClassVar[str | None] = "gear"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"mu": 5.0})
    """A motor is thought to give 0.2 N m."""

    mu: float = parameter("1", 0.02, low=0.0, high=2.0)

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """Every motor at a joint whose torque falls with speed."""
        return tuple(e for e in super().candidates(model) if model.actuator(e.where).biasprm[2] < 0)

    def dry_friction(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """In proportion to the motor's torque."""
        return self.mu * functions(v).abs(load())

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The same against the motion."""
        dof, out = self.dof(model), np.zeros_like(v)
        torque = actuator_torque(model, self.slot(model)[1], q[..., dof], v[..., dof], u)
        out[..., dof] = -self.dry_friction(q, v, lambda: torque) * smooth_sign(v[..., dof])
        return out
