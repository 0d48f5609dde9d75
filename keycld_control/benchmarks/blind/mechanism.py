"""What a sealed case has and the simulator lacks: one dataclass per mechanism, with the slots that it acts in."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class StepState:
    """The state in the middle of a step, as plain floats, and the forces that add up.

    Attributes:
        t: seconds since the first sample.
        h: seconds per step.
        q: positions, rad or m.
        v: velocities.
        a: accelerations over the step before.
        u: commands as recorded.
        f: generalised forces, to which mechanisms add, N m or N.
    """

    __slots__ = ("a", "f", "h", "q", "t", "u", "v")

    def __init__(self, size: int, commands: int, step: float) -> None:
        self.t, self.h = 0.0, step
        self.q, self.v, self.a, self.f = ([0.0] * size for _ in range(4))
        self.u = [0.0] * commands


@dataclass(frozen=True)
class Run:
    """One recording while it is simulated.

    Attributes:
        model: of this run alone; mechanisms may change it.
        data: state of this run.
        rng: random numbers for what differs between runs.
        duration: seconds that are recorded.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    rng: np.random.Generator
    duration: float


Motor = Callable[[float, float], float]
Force = Callable[[StepState], None]
DryFriction = Callable[[StepState], tuple[float, float]]
Transmission = Callable[[StepState, float], float]
Push = Callable[[float], tuple[float, float]]


@dataclass(frozen=True)
class CaseMechanism:
    """Physics at one place that the simulator lacks.

    Every slot returns a function with a memory of its own, or None where it does nothing.

    Attributes:
        joint: index of the joint, -1 where there is none.
        actuator: index of the actuator, -1 where there is none.
    """

    id: ClassVar[str]
    joint: int
    actuator: int

    def edit(self, model: mujoco.MjModel) -> None:
        """Change a compiled model in place."""

    def start(self, q: Array) -> Array:
        """Positions `[nv]` to start from, in place of those that were drawn, rad or m."""
        return q

    def motor(self, run: Run) -> Motor | None:
        """The command that takes effect, as a function of the time (s) and the command that was given."""
        return None

    def transmission(self, run: Run) -> Transmission | None:
        """The torque that reaches the joint, as a function of the state and the motor's torque, N m or N."""
        return None

    def force(self, run: Run) -> Force | None:
        """A function that adds to the generalised forces of a state."""
        return None

    def dry_friction(self, run: Run) -> DryFriction | None:
        """Limits of dry friction, forward and backward, both at least zero, N m or N."""
        return None

    def push(self, run: Run) -> Push | None:
        """Acceleration of the base along x and z, m/s², as a function of the time, s."""
        return None

    def alter(self, run: Run) -> Callable[[float], None] | None:
        """A function of the time (s) that changes the model of the run."""
        return None

    def measured_times(self, t: Array) -> Array:
        """Times of the motion that a sensor shows at its own times `[T]`, s."""
        return t

    def parameters(self) -> dict[str, Any]:
        """All parameters by name, for the answers."""
        return {k: v for k, v in asdict(self).items() if k not in ("joint", "actuator")}

    def comparable(self) -> dict[str, float]:
        """Parameters that any tool would mean the same by, named as in the taxonomy."""
        return {}


ORDER = (
    "actuator_delay",
    "actuator_dead_zone",
    "actuator_lag",
    "actuator_saturation",
    "actuator_gain",
    "parameter_drift",
)
"""The order in which mechanisms of a motor follow each other: wire, driver, current, limit, torque constant."""
