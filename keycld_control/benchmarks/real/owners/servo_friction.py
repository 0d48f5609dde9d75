"""The friction of a servo as its owners model it (Duclusaud, Passault et al., Extended friction models, 2024)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, Self

import mujoco
import numpy as np

from keycld_control.benchmarks.real import servo
from keycld_control.benchmarks.real.owners.model import OwnersModel
from keycld_envs.effects import ViscousFriction
from keycld_envs.effects.base import Array
from keycld_envs.effects.edited import actuator_torque
from keycld_envs.effects.functions import functions, smooth_sign
from keycld_envs.effects.places import ActuatorEffect

NAMES = ("m1", "m2", "m3", "m4", "m5", "m6")
"""From dry and viscous friction to friction that depends on both loads, and their squares, and fades with speed."""


@dataclass(frozen=True)
class ServoFriction(ActuatorEffect):
    """Dry friction that depends on the torques of motor and load, and in part fades with speed.

    Fields are those of the owners' files, N m, 1, 1/(N m), rad/s, besides the weight that loads the servo, N m, at the
    angle of the horn where the servo says zero, rad.
    """

    id: ClassVar[str] = "servo_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(c(tau_motor, tau_load) + s(tau_motor, tau_load)*exp(-|qd/vs|^alpha))*sign(qd)"
    at_joint: ClassVar[bool] = True
    searched: ClassVar[bool] = False
    program: ClassVar[str | None] = "servo"

    friction_base: float = 0.0
    friction_stribeck: float = 0.0
    load_friction_motor: float = 0.0
    load_friction_external: float = 0.0
    load_friction_motor_stribeck: float = 0.0
    load_friction_external_stribeck: float = 0.0
    load_friction_motor_quad: float = 0.0
    load_friction_external_quad: float = 0.0
    dtheta_stribeck: float = 1.0
    alpha: float = 1.0
    weight: float = 0.0
    q_offset: float = 0.0

    @classmethod
    def of(cls, known: Mapping[str, float]) -> Self:
        """With numbers of a file; where these do not tell motor and load apart, the difference of both counts."""
        own = {f.name for f in fields(cls)} - {"where"}
        numbers = {name: value for name, value in known.items() if name in own}
        for part, whole in (("", "load_friction_base"), ("_stribeck", "load_friction_stribeck")):
            if whole in known:
                numbers |= dict.fromkeys((f"load_friction_motor{part}", f"load_friction_external{part}"), known[whole])
        return cls("servo", **numbers, weight=servo.MASS * servo.GRAVITY * servo.LENGTH)

    def dry_friction(self, q: Array, v: Array, load: Callable[[], Array]) -> Array:
        """N m."""
        xp, motor = functions(v), load()
        outside = -self.weight * xp.sin(q + self.q_offset)
        steady = self.friction_base + xp.abs(self.load_friction_external * outside - self.load_friction_motor * motor)
        slow = self.friction_stribeck + xp.abs(
            self.load_friction_external_stribeck * outside - self.load_friction_motor_stribeck * motor
        )
        square = xp.where(
            xp.abs(outside) < xp.abs(motor),
            self.load_friction_external_quad * outside**2,
            self.load_friction_motor_quad * motor**2,
        )
        slow = slow + xp.where(xp.sign(outside) == xp.sign(motor), 0.0, square)
        return steady + slow * xp.exp(-(xp.abs(v / self.dtheta_stribeck) ** self.alpha))

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The same against the motion."""
        dof, out = self.dof(model), np.zeros_like(v)
        torque = actuator_torque(model, self.slot(model)[1], q[..., dof], v[..., dof], u)
        out[..., dof] = -self.dry_friction(q[..., dof], v[..., dof], lambda: torque) * smooth_sign(v[..., dof])
        return out


def owners_models(folder: Path) -> list[OwnersModel]:
    """All of the servo.

    Raises:
        InputError: if a file is missing or damaged.
    """
    out = []
    for name in NAMES:
        known = servo.motor_constants(folder, name)
        effects = ServoFriction.of(known), ViscousFriction("hinge", known["friction_viscous"])
        out.append(OwnersModel(name, servo.simulator(folder, name), effects))
    return out
