"""Forces from outside, and springs."""

from dataclasses import dataclass
from math import cos, pi, sin
from typing import ClassVar

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.mechanism import Array, CaseMechanism, Force, Push, Run, StepState


@dataclass(frozen=True)
class LinearSpring(CaseMechanism):
    """A spring, -k (q - q0)."""

    id: ClassVar[str] = "spring"
    k: float
    q0: float

    def force(self, run: Run) -> Force:
        """The force of the spring."""
        j, k, q0 = self.joint, self.k, self.q0

        def add(now: StepState) -> None:
            now.f[j] -= k * (now.q[j] - q0)

        return add

    def comparable(self) -> dict[str, float]:
        """The stiffness, N m/rad or N/m."""
        return {"k": self.k}


@dataclass(frozen=True)
class Constant(CaseMechanism):
    """A constant force f."""

    id: ClassVar[str] = "constant_force"
    f: float

    def force(self, run: Run) -> Force:
        """The force f."""
        j, f = self.joint, self.f

        def add(now: StepState) -> None:
            now.f[j] += f

        return add

    def comparable(self) -> dict[str, float]:
        """The force, N m or N."""
        return {"f": self.f}


@dataclass(frozen=True)
class Tilt(CaseMechanism):
    """Gravity that is turned by alpha towards +x."""

    id: ClassVar[str] = "gravity_tilt"
    alpha: float

    def edit(self, model: mujoco.MjModel) -> None:
        """Turn the gravity of the model."""
        size = float(np.linalg.norm(model.opt.gravity))
        model.opt.gravity[:] = size * sin(self.alpha), 0.0, -size * cos(self.alpha)

    def comparable(self) -> dict[str, float]:
        """The angle, rad."""
        return {"alpha": self.alpha}


@dataclass(frozen=True)
class TorqueRipple(CaseMechanism):
    """A torque ripple over the position, f sin(n q + phase)."""

    id: ClassVar[str] = "cogging"
    f: float
    n: float
    phase: float

    def force(self, run: Run) -> Force:
        """The ripple's force."""
        j = self.joint

        def add(now: StepState) -> None:
            now.f[j] += self.f * sin(self.n * now.q[j] + self.phase)

        return add

    def comparable(self) -> dict[str, float]:
        """The order: periods per turn, or per metre times 2 pi."""
        return {"n": self.n}


@dataclass(frozen=True)
class Pushes(CaseMechanism):
    """One to three pushes in every recording, rectangles or half sines of up to f.

    Signs and times are drawn anew in each run; `Pushes.windows` tells them for an equal generator.
    """

    id: ClassVar[str] = "external_pulse"
    f: float
    width: float
    rounded: bool

    def windows(self, rng: np.random.Generator, duration: float) -> list[tuple[float, float, float]]:
        """Start (s), end (s), and force of each push, apart from each other."""
        number = int(rng.integers(1, 4))
        slots = np.sort(rng.permutation(3)[:number])
        share = duration / 3
        out = []
        for slot in slots:
            start = slot * share + rng.uniform(0.05, share - 1.2 * self.width - 0.05)
            out.append((start, start + self.width * rng.uniform(0.8, 1.2), self.f * float(rng.choice([-1.0, 1.0]))))
        return [(float(a), float(b), float(f)) for a, b, f in out]

    def force(self, run: Run) -> Force:
        """The force of the push that acts at a time."""
        j, windows = self.joint, self.windows(run.rng, run.duration)

        def add(now: StepState) -> None:
            for start, end, f in windows:
                if start <= now.t < end:
                    now.f[j] += f * (sin(pi * (now.t - start) / (end - start)) if self.rounded else 1.0)

        return add


@dataclass(frozen=True)
class Periodic(CaseMechanism):
    """A periodic force f sin(w t + phase), t being the recording's own time."""

    id: ClassVar[str] = "external_periodic"
    f: float
    w: float
    phase: float

    def force(self, run: Run) -> Force:
        """The sinusoidal force."""
        j = self.joint

        def add(now: StepState) -> None:
            now.f[j] += self.f * sin(self.w * now.t + self.phase)

        return add

    def comparable(self) -> dict[str, float]:
        """The angular frequency, rad/s."""
        return {"w": self.w}


@dataclass(frozen=True)
class BaseVibration(CaseMechanism):
    """A base that moves by size sin(w t + phase) along x or z; in its frame gravity is less by the acceleration."""

    id: ClassVar[str] = "base_motion"
    size: float
    w: float
    phase: float
    vertical: bool

    def push(self, run: Run) -> Push:
        """The acceleration of the base."""
        top = -self.size * self.w**2

        def acceleration(t: float) -> tuple[float, float]:
            now = top * sin(self.w * t + self.phase)
            return (0.0, now) if self.vertical else (now, 0.0)

        return acceleration

    def comparable(self) -> dict[str, float]:
        """The angular frequency, rad/s."""
        return {"w": self.w}


@dataclass(frozen=True)
class CompliantStop(CaseMechanism):
    """An end stop, -(k x + d v) for a depth x = side (q - at) > 0, never pulling back."""

    id: ClassVar[str] = "end_stop"
    k: float
    at: float
    side: float
    d: float

    def start(self, q: Array) -> Array:
        """Positions inside the stop are mirrored out of it."""
        q = q.copy()
        depth = self.side * (q[self.joint] - self.at)
        if depth > 0:
            q[self.joint] -= 2 * self.side * depth
        return q

    def force(self, run: Run) -> Force:
        """The force of a spring and a damper while the joint is inside the stop."""
        j = self.joint

        def add(now: StepState) -> None:
            depth = self.side * (now.q[j] - self.at)
            if depth > 0:
                now.f[j] -= self.side * max(0.0, self.k * depth + self.d * self.side * now.v[j])

        return add

    def comparable(self) -> dict[str, float]:
        """The position of the stop, rad or m."""
        return {"at": self.at}
