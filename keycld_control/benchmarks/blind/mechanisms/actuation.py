"""What motors make of their commands."""

from collections import deque
from dataclasses import dataclass
from math import copysign, exp
from typing import ClassVar

from keycld_control.benchmarks.blind.mechanism import Mechanism, Motor, Run

_H = 1e-3


@dataclass(frozen=True)
class Gain(Mechanism):
    """k u."""

    id: ClassVar[str] = "actuator_gain"
    k: float

    def motor(self, run: Run) -> Motor:
        """Stronger or weaker."""
        k = self.k
        return lambda t, u: k * u

    def comparable(self) -> dict[str, float]:
        """Its factor."""
        return {"k": self.k}


@dataclass(frozen=True)
class Saturation(Mechanism):
    """At most s."""

    id: ClassVar[str] = "actuator_saturation"
    s: float

    def motor(self, run: Run) -> Motor:
        """Clipped."""
        s = self.s
        return lambda t, u: min(max(u, -s), s)

    def comparable(self) -> dict[str, float]:
        """Its limit."""
        return {"s": self.s}


@dataclass(frozen=True)
class DeadZone(Mechanism):
    """Less by delta, none below it."""

    id: ClassVar[str] = "actuator_dead_zone"
    delta: float

    def motor(self, run: Run) -> Motor:
        """The middle cut out."""
        delta = self.delta
        return lambda t, u: copysign(max(0.0, abs(u) - delta), u)

    def comparable(self) -> dict[str, float]:
        """Its half width."""
        return {"delta": self.delta}


@dataclass(frozen=True)
class Lag(Mechanism):
    """lag da/dt = u - a, exactly, averaged over the step."""

    id: ClassVar[str] = "actuator_lag"
    lag: float

    def motor(self, run: Run) -> Motor:
        """Starts where the first command had long held."""
        lag, keep, a = self.lag, exp(-_H / self.lag), None

        def follow(t: float, u: float) -> float:
            nonlocal a
            before = u if a is None else a
            a = u + (before - u) * keep
            return u + (before - u) * (1 - keep) * lag / _H

        return follow

    def comparable(self) -> dict[str, float]:
        """Its time constant."""
        return {"lag": self.lag}


@dataclass(frozen=True)
class Delay(Mechanism):
    """u(t - d); parts of a step by sharing its impulse."""

    id: ClassVar[str] = "actuator_delay"
    d: float

    def motor(self, run: Run) -> Motor:
        """Starts where the first command had long held."""
        whole = int(self.d / _H)
        part = self.d / _H - whole
        past: deque[float] = deque(maxlen=whole + 2)

        def late(t: float, u: float) -> float:
            if not past:
                past.extend([u] * (whole + 2))
            past.append(u)
            return (1 - part) * past[1] + part * past[0]

        return late

    def comparable(self) -> dict[str, float]:
        """Its time."""
        return {"d": self.d}
