"""What sensors show, and parameters that change with time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

from keycld_control.benchmarks.blind.mechanism import Array, CaseMechanism, Force, Motor, Run, StepState


@dataclass(frozen=True)
class Latency(CaseMechanism):
    """Sensors of all joints that show the past, y(t) = q(t - d)."""

    id: ClassVar[str] = "sensor_latency"
    d: float

    def measured_times(self, t: Array) -> Array:
        """Times that are earlier by the latency, s."""
        return t - self.d

    def comparable(self) -> dict[str, float]:
        """The latency, s."""
        return {"d": self.d}


@dataclass(frozen=True)
class Drift(CaseMechanism):
    """A clock of the sensors that is off, y(t) = q((1 + epsilon) t); commands keep true time."""

    id: ClassVar[str] = "clock_drift"
    epsilon: float

    def measured_times(self, t: Array) -> Array:
        """Times of the motion by the clock, s."""
        return (1 + self.epsilon) * t

    def comparable(self) -> dict[str, float]:
        """The relative error of the clock's rate."""
        return {"epsilon": self.epsilon}


@dataclass(frozen=True)
class ChangingParameter(CaseMechanism):
    """A parameter that changes linearly with the time t since the start of every recording, which lasts T.

    kind "friction": -size t/T v, a bearing that stiffens. kind "gain": (1 - size t/T) u, a motor that warms up.
    kind "mass": the joint's body has (1 - size t/T) of its mass and inertia, a tank that leaks. Before t = 0, as at 0.
    """

    id: ClassVar[str] = "parameter_drift"
    kind: Literal["friction", "gain", "mass"]
    size: float

    def force(self, run: Run) -> Force | None:
        """The friction, if it is what changes."""
        j, rate = self.joint, self.size / run.duration

        def add(now: StepState) -> None:
            now.f[j] -= rate * max(0.0, now.t) * now.v[j]

        return add if self.kind == "friction" else None

    def motor(self, run: Run) -> Motor | None:
        """The command times the gain, if it is what changes."""
        rate = self.size / run.duration
        return (lambda t, u: (1 - rate * max(0.0, t)) * u) if self.kind == "gain" else None

    def alter(self, run: Run) -> Callable[[float], None] | None:
        """Changes the body's mass, if it is what changes."""
        model, body, rate = run.model, int(run.model.jnt_bodyid[self.joint]), self.size / run.duration
        mass, inertia = float(model.body_mass[body]), model.body_inertia[body].copy()

        def leak(t: float) -> None:
            left = 1 - rate * max(0.0, t)
            model.body_mass[body] = mass * left
            model.body_inertia[body] = inertia * left

        return leak if self.kind == "mass" else None
