"""Dissipation. Dry friction is a pair of limits, which the plant applies exactly; the rest are smooth forces."""

from dataclasses import dataclass
from math import exp, sin
from typing import ClassVar

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.mechanism import CaseMechanism, DryFriction, Force, Run, StepState


@dataclass(frozen=True)
class Viscous(CaseMechanism):
    """Viscous friction, -b v."""

    id: ClassVar[str] = "viscous_friction"
    b: float

    def force(self, run: Run) -> Force:
        """A force proportional to the speed."""
        j, b = self.joint, self.b

        def add(now: StepState) -> None:
            now.f[j] -= b * now.v[j]

        return add

    def comparable(self) -> dict[str, float]:
        """The coefficient, N m s/rad or N s/m."""
        return {"b": self.b}


@dataclass(frozen=True)
class Drag(CaseMechanism):
    """Quadratic drag, -d v abs(v)."""

    id: ClassVar[str] = "quadratic_drag"
    d: float

    def force(self, run: Run) -> Force:
        """A force proportional to the square of the speed."""
        j, d = self.joint, self.d

        def add(now: StepState) -> None:
            now.f[j] -= d * now.v[j] * abs(now.v[j])

        return add

    def comparable(self) -> dict[str, float]:
        """The coefficient, N m s²/rad² or N s²/m²."""
        return {"d": self.d}


@dataclass(frozen=True)
class Coulomb(CaseMechanism):
    """Coulomb friction, -c sign v, and up to c at rest."""

    id: ClassVar[str] = "coulomb_friction"
    c: float

    def dry_friction(self, run: Run) -> DryFriction:
        """Constant limits."""
        limits = self.c, self.c
        return lambda now: limits

    def comparable(self) -> dict[str, float]:
        """The friction, N m or N."""
        return {"c": self.c}


@dataclass(frozen=True)
class Stribeck(CaseMechanism):
    """Stribeck friction, -(c + (s - c) exp(-(v/vs)^2)) sign v, and up to s at rest."""

    id: ClassVar[str] = "stribeck_friction"
    c: float
    s: float
    vs: float

    def dry_friction(self, run: Run) -> DryFriction:
        """Limits that are higher at low speed."""
        j, c, extra, vs = self.joint, self.c, self.s - self.c, self.vs

        def limits(now: StepState) -> tuple[float, float]:
            size = c + extra * exp(-((now.v[j] / vs) ** 2))
            return size, size

        return limits

    def comparable(self) -> dict[str, float]:
        """The friction at high speed, N m or N."""
        return {"c": self.c}


@dataclass(frozen=True)
class LoadDependent(CaseMechanism):
    """Friction in proportion to the load, -mu abs(N) sign v.

    N is the force that the joint's parent exerts on the body, from MuJoCo's recursive Newton-Euler: for a hinge the
    magnitude of the bearing's force in the plane of motion, mu being coefficient times radius (m); for a slide its
    component across the rail, mu being the coefficient. N is of the end of the step before.
    """

    id: ClassVar[str] = "load_dependent_friction"
    mu: float

    def dry_friction(self, run: Run) -> DryFriction:
        """Limits in proportion to the load."""
        body, data = int(run.model.jnt_bodyid[self.joint]), run.data
        slide = run.model.jnt_type[self.joint] == mujoco.mjtJoint.mjJNT_SLIDE
        axis = run.model.jnt_axis[self.joint].copy()

        def limits(now: StepState) -> tuple[float, float]:
            mujoco.mj_rnePostConstraint(run.model, data)
            load = data.cfrc_int[body, 3:]
            if slide:
                load = load - axis * (axis @ load)
            size = self.mu * float(np.sqrt(load @ load))
            return size, size

        return limits


@dataclass(frozen=True)
class Asymmetric(CaseMechanism):
    """Coulomb friction that depends on the direction: -forward where v > 0, +backward where v < 0."""

    id: ClassVar[str] = "asymmetric_friction"
    forward: float
    backward: float

    def dry_friction(self, run: Run) -> DryFriction:
        """Limits of the two directions."""
        limits = self.forward, self.backward
        return lambda now: limits

    def comparable(self) -> dict[str, float]:
        """The friction in each direction, N m or N."""
        return {"forward": self.forward, "backward": self.backward}


@dataclass(frozen=True)
class PositionDependent(CaseMechanism):
    """Friction -c (1 + share sin(q + phase)) sign v, with a share of at most one."""

    id: ClassVar[str] = "position_dependent_friction"
    c: float
    share: float
    phase: float

    def dry_friction(self, run: Run) -> DryFriction:
        """Limits that vary over a turn."""
        j = self.joint

        def limits(now: StepState) -> tuple[float, float]:
            size = self.c * (1 + self.share * sin(now.q[j] + self.phase))
            return size, size

        return limits

    def comparable(self) -> dict[str, float]:
        """The friction averaged over a turn, N m or N."""
        return {"c": self.c}


@dataclass(frozen=True)
class LuGre(CaseMechanism):
    """Friction of bristles (Canudas de Wit et al., 1995): tau = -(stiffness z + damping zd).

    zd = v - stiffness abs(v)/g(v) z with g(v) = c + (s - c) exp(-(v/vs)^2); z is integrated exactly for a speed that is
    constant over a step.
    """

    id: ClassVar[str] = "hysteretic_friction"
    c: float
    s: float
    vs: float
    stiffness: float
    damping: float

    def force(self, run: Run) -> Force:
        """The force of the mean deflection over the step."""
        j, z = self.joint, 0.0

        def add(now: StepState) -> None:
            nonlocal z
            v, h = now.v[j], now.h
            rate = self.stiffness * abs(v) / (self.c + (self.s - self.c) * exp(-((v / self.vs) ** 2)))
            new = z + v * h if rate * h < 1e-9 else v / rate + (z - v / rate) * exp(-rate * h)
            now.f[j] -= self.stiffness * 0.5 * (z + new) + self.damping * (new - z) / h
            z = new

        return add
