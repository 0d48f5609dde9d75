"""What motors make of their commands."""

from collections import deque
from dataclasses import dataclass
from math import copysign, exp
from typing import ClassVar

from keycld_control.benchmarks.blind.mechanism import CaseMechanism, Motor, Run

_H = 1e-3
"""Step of the plant, s."""


@dataclass(frozen=True)
class Gain(CaseMechanism):
    """A motor that gives k u for the command u."""

    id: ClassVar[str] = "actuator_gain"
    k: float

    def motor(self, run: Run) -> Motor:
        """The command times the gain."""
        k = self.k
        return lambda t, u: k * u

    def comparable(self) -> dict[str, float]:
        """The gain."""
        return {"k": self.k}


@dataclass(frozen=True)
class Saturation(CaseMechanism):
    """A motor that gives at most s, in units of commands."""

    id: ClassVar[str] = "actuator_saturation"
    s: float

    def motor(self, run: Run) -> Motor:
        """The command, clipped."""
        s = self.s
        return lambda t, u: min(max(u, -s), s)

    def comparable(self) -> dict[str, float]:
        """The limit, in units of commands."""
        return {"s": self.s}


@dataclass(frozen=True)
class DeadZone(CaseMechanism):
    """A motor that gives less than its command by delta, and nothing below it."""

    id: ClassVar[str] = "actuator_dead_zone"
    delta: float

    def motor(self, run: Run) -> Motor:
        """The command less half the width of the dead zone."""
        delta = self.delta
        return lambda t, u: copysign(max(0.0, abs(u) - delta), u)

    def comparable(self) -> dict[str, float]:
        """Half the width of the dead zone, in units of commands."""
        return {"delta": self.delta}


@dataclass(frozen=True)
class Lag(CaseMechanism):
    """A motor whose activation a follows lag da/dt = u - a, integrated exactly and averaged over the step."""

    id: ClassVar[str] = "actuator_lag"
    lag: float

    def motor(self, run: Run) -> Motor:
        """The delayed command; before the run the first one held."""
        lag, keep, a = self.lag, exp(-_H / self.lag), None

        def follow(t: float, u: float) -> float:
            nonlocal a
            before = u if a is None else a
            a = u + (before - u) * keep
            return u + (before - u) * (1 - keep) * lag / _H

        return follow

    def comparable(self) -> dict[str, float]:
        """The time constant, s."""
        return {"lag": self.lag}


@dataclass(frozen=True)
class Delay(CaseMechanism):
    """A motor that gives u(t - d); a part of a step shares its impulse."""

    id: ClassVar[str] = "actuator_delay"
    d: float

    def motor(self, run: Run) -> Motor:
        """The delayed command; before the run the first one held."""
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
        """The delay, s."""
        return {"d": self.d}
