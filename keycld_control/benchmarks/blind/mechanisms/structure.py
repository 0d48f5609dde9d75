"""Inertia, and what lies between motor and joint."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.mechanism import CaseMechanism, Run, StepState, Transmission

SUBSTEPS = 4
"""Steps of the rotor per step of the plant."""


@dataclass(frozen=True)
class Rotor(CaseMechanism):
    """An inertia i that turns with the joint: a rotor behind a gear."""

    id: ClassVar[str] = "added_inertia"
    i: float

    def edit(self, model: mujoco.MjModel) -> None:
        """An armature, which only the joint's own acceleration feels."""
        model.dof_armature[self.joint] += self.i

    def comparable(self) -> dict[str, float]:
        """The inertia, kg m² or kg."""
        return {"i": self.i}


@dataclass(frozen=True)
class PointMass(CaseMechanism):
    """A mass (kg) fixed to the joint's body, `reach` (m) from the joint along the link."""

    id: ClassVar[str] = "added_inertia"
    mass: float
    reach: float

    def edit(self, model: mujoco.MjModel) -> None:
        """Mass, centre of mass, and inertia of the body and the point mass together."""
        body = int(model.jnt_bodyid[self.joint])
        old, new = float(model.body_mass[body]), np.array([0.0, 0.0, self.reach])
        total, turn = old + self.mass, np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[body])
        axes = turn.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        centre = (old * model.body_ipos[body] + self.mass * new) / total
        for mass, point in ((old, model.body_ipos[body] - centre), (self.mass, new - centre)):
            inertia += mass * (point @ point * np.eye(3) - np.outer(point, point))
        principal, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(axes).ravel())
        model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = total, centre, principal


@dataclass(frozen=True)
class _Coupled(CaseMechanism):
    """A rotor that the motor turns, with torques towards the joint that depend on the twist between the two."""

    rotor: float

    def twist_torque(self, twist: float, rate: float) -> float:
        """The torque on the joint, for how far and fast the rotor is ahead of it."""
        raise NotImplementedError

    def rest(self, torque: float) -> float:
        """The twist under a constant torque."""
        raise NotImplementedError

    def transmission(self, run: Run) -> Transmission:
        """Small symplectic steps of the rotor beside a joint that moves with constant acceleration."""
        j, h = self.joint, 0.0
        angle = speed = None

        def reach(now: StepState, torque: float) -> float:
            nonlocal angle, speed, h
            h = now.h / SUBSTEPS
            q0 = now.q[j] - 0.5 * now.h * now.v[j] + 0.125 * now.h**2 * now.a[j]
            v0 = now.v[j] - 0.5 * now.h * now.a[j]
            if angle is None or speed is None:
                angle, speed = q0 + self.rest(torque), v0
            total = 0.0
            for k in range(SUBSTEPS):
                t = (k + 0.5) * h
                q, v = q0 + v0 * t + 0.5 * now.a[j] * t * t, v0 + now.a[j] * t
                middle = angle + 0.5 * h * speed
                passed = self.twist_torque(middle - q, speed - v)
                speed += h * (torque - passed) / self.rotor
                angle = middle + 0.5 * h * speed
                total += passed
            return total / SUBSTEPS

        return reach


@dataclass(frozen=True)
class Flexible(_Coupled):
    """A flexible joint: rotor and joint are joined by a spring k and a damper d."""

    id: ClassVar[str] = "joint_flexibility"
    k: float
    d: float

    def twist_torque(self, twist: float, rate: float) -> float:
        """The torque of the spring and the damper."""
        return self.k * twist + self.d * rate

    def rest(self, torque: float) -> float:
        """The twist by Hooke's law."""
        return torque / self.k

    def comparable(self) -> dict[str, float]:
        """The stiffness, N m/rad or N/m."""
        return {"k": self.k}


@dataclass(frozen=True)
class GearPlay(_Coupled):
    """Backlash: rotor and joint touch where the twist exceeds half the play, over a spring k and a damper d."""

    id: ClassVar[str] = "backlash"
    half: float
    k: float
    d: float

    def twist_torque(self, twist: float, rate: float) -> float:
        """The torque of a contact that pushes and never pulls."""
        if abs(twist) <= self.half:
            return 0.0
        side = 1.0 if twist > 0 else -1.0
        return side * max(0.0, self.k * (abs(twist) - self.half) + self.d * side * rate)

    def rest(self, torque: float) -> float:
        """The twist where the motor pushes against the play's side."""
        return torque / self.k + (self.half if torque > 0 else -self.half if torque < 0 else 0.0)
