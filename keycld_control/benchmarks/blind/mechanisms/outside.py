"""Physics that no effect of the taxonomy expresses; the right answer is "unknown"."""

from dataclasses import dataclass
from math import exp, sin
from typing import ClassVar

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.mechanism import CaseMechanism, Force, Motor, Run, StepState

SUBSTEPS = 4
"""Steps of a hidden mass per step of the plant."""


@dataclass(frozen=True)
class _Outside(CaseMechanism):
    id: ClassVar[str] = "unknown"
    kind: ClassVar[str]

    def parameters(self) -> dict[str, object]:
        """All parameters by name, and the kind."""
        return {"kind": self.kind, **super().parameters()}


@dataclass(frozen=True)
class Magnet(_Outside):
    """A magnet beside one position: -f x w^2/(x^2 + w^2)^(3/2)/.385 with x = q - at; f is the greatest force."""

    kind: ClassVar[str] = "magnet"
    f: float
    at: float
    width: float

    def force(self, run: Run) -> Force:
        """An inverse square of the distance, projected on the motion; nearly none a few widths away."""
        j, w2 = self.joint, self.width**2

        def add(now: StepState) -> None:
            x = now.q[j] - self.at
            now.f[j] -= self.f / 0.385 * x * w2 / (x * x + w2) ** 1.5

        return add


@dataclass(frozen=True)
class _AtTip(_Outside):
    """Physics that acts on a point of the joint's body, `reach` (m) along the link."""

    reach: float

    def point(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """World position `[3]` and Jacobian `[3, nv]`."""
        body = int(run.model.jnt_bodyid[self.joint])
        place = run.data.xpos[body] + self.reach * run.data.xmat[body].reshape(3, 3)[:, 2]
        jacobian = np.zeros((3, run.model.nv))
        mujoco.mj_jac(run.model, run.data, jacobian, None, place, body)
        return place, jacobian


@dataclass(frozen=True)
class Wind(_AtTip):
    """Drag of the tip in air that moves along x: -c abs(v - w) (v - w), w swinging by half with angular rate `gust`."""

    kind: ClassVar[str] = "wind"
    c: float
    speed: float
    gust: float

    def force(self, run: Run) -> Force:
        """The drag in the world, as generalised forces."""

        def add(now: StepState) -> None:
            _, jacobian = self.point(run)
            relative = jacobian @ now.v
            relative[0] -= self.speed * (1 + 0.5 * sin(self.gust * now.t))
            for j, torque in enumerate(jacobian.T @ relative * (-self.c * float(np.linalg.norm(relative)))):
                now.f[j] += float(torque)

        return add


@dataclass(frozen=True)
class Slosh(_AtTip):
    """A hidden mass on an isotropic spring (angular frequency w, damping ratio zeta) at a point of the link."""

    kind: ClassVar[str] = "slosh"
    mass: float
    w: float
    zeta: float

    def force(self, run: Run) -> Force:
        """The reaction of the spring and the damper; the mass starts where its weight hangs."""
        k, d = self.mass * self.w**2, 2 * self.zeta * self.w * self.mass
        place, speed, started = np.zeros(3), np.zeros(3), False

        def add(now: StepState) -> None:
            nonlocal place, speed, started
            anchor, jacobian = self.point(run)
            moving, h = jacobian @ now.v, now.h / SUBSTEPS
            gravity = run.model.opt.gravity
            if not started:
                place, speed, started = anchor + gravity / self.w**2, moving.copy(), True
            total = np.zeros(3)
            for i in range(SUBSTEPS):
                middle = place + 0.5 * h * speed
                pull = k * (middle - anchor - (i + 0.5) * h * moving) + d * (speed - moving)
                speed = speed + h * (gravity - pull / self.mass)
                place = middle + 0.5 * h * speed
                total += pull
            for j, torque in enumerate(jacobian.T @ total / SUBSTEPS):
                now.f[j] += float(torque)

        return add


@dataclass(frozen=True)
class SpeedLaw(_Outside):
    """A force f (x^3 - x^5), x = v/v0, that drives below v0 and brakes above: not viscous, not dry, not quadratic."""

    kind: ClassVar[str] = "speed_law"
    f: float
    v0: float

    def force(self, run: Run) -> Force:
        """The force; faster than 2 v0 counts as 2 v0."""
        j = self.joint

        def add(now: StepState) -> None:
            x = min(max(now.v[j] / self.v0, -2.0), 2.0)
            now.f[j] += self.f * (x**3 - x**5)

        return add


@dataclass(frozen=True)
class Efficiency(_Outside):
    """A motor that is stronger at some positions: (1 + share sin(n q)) u."""

    kind: ClassVar[str] = "efficiency"
    share: float
    n: float

    def motor(self, run: Run) -> Motor:
        """A command that depends on the position."""
        data, j = run.data, self.joint
        return lambda t, u: u * (1 + self.share * sin(self.n * float(data.qpos[j])))


@dataclass(frozen=True)
class Relaxation(_Outside):
    """A Maxwell element, spring k and dashpot in series with relaxation time tau: a force that remembers the motion."""

    kind: ClassVar[str] = "relaxation"
    k: float
    tau: float

    def force(self, run: Run) -> Force:
        """The force of the mean stretch, exact for a constant speed over the step."""
        j, stretch, keep = self.joint, 0.0, 0.0

        def add(now: StepState) -> None:
            nonlocal stretch, keep
            keep = exp(-now.h / self.tau)
            new = stretch * keep + now.v[j] * self.tau * (1 - keep)
            now.f[j] -= self.k * 0.5 * (stretch + new)
            stretch = new

        return add


@dataclass(frozen=True)
class Cross(_Outside):
    """A joint that feels the other's speed: -c v of the other, without a reaction there."""

    kind: ClassVar[str] = "cross_coupling"
    c: float

    def force(self, run: Run) -> Force:
        """A force that is neither conservative nor dissipative."""
        j, other = self.joint, 1 - self.joint

        def add(now: StepState) -> None:
            now.f[j] -= self.c * now.v[other]

        return add


@dataclass(frozen=True)
class Gyroscope(_Outside):
    """A flywheel between two joints: +c v of the second at the first, -c v of the first at the second."""

    kind: ClassVar[str] = "gyroscope"
    c: float

    def force(self, run: Run) -> Force:
        """Forces without power."""

        def add(now: StepState) -> None:
            now.f[0] += self.c * now.v[1]
            now.f[1] -= self.c * now.v[0]

        return add


@dataclass(frozen=True)
class Cable(_Outside):
    """A cable that is taut where q0 + ratio q1 exceeds a length: k times the excess, on both joints."""

    kind: ClassVar[str] = "cable"
    k: float
    ratio: float
    length: float

    def force(self, run: Run) -> Force:
        """Forces that pull and never push."""

        def add(now: StepState) -> None:
            pull = self.k * max(0.0, now.q[0] + self.ratio * now.q[1] - self.length)
            now.f[0] -= pull
            now.f[1] -= self.ratio * pull

        return add
