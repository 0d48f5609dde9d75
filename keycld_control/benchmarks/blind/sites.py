"""Where mechanisms can be, and what is large and small there."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Site:
    """One joint with its motor.

    Attributes:
        system: short name.
        joint: index.
        name: of the joint.
        motor: name of its actuator, which has the same index.
        body: name of the body that it moves.
        slide: it moves along a line; else read rad, N m, kg m^2 below.
        torque: typical of the motion, N.
        inertia: felt by the motor, kg.
        speed: typical, m/s.
        load: weight that it carries, N.
        mass: of its body, kg.
        rest: stable position, m.
        swing: how far it moves from there, m.
        command: typical amplitude.
    """

    system: str
    joint: int
    name: str
    motor: str
    body: str
    slide: bool
    torque: float
    inertia: float
    speed: float
    load: float
    mass: float
    rest: float
    swing: float
    command: float


SITES = (
    Site("pendulum", 0, "hinge", "torque", "pole", False, 1.5, 0.25, 3.0, 9.8, 1.0, 3.1416, 1.2, 0.9),
    Site("cartpole", 0, "slider", "slide", "cart", True, 1.5, 1.1, 1.0, 10.8, 1.0, 0.0, 0.4, 0.6),
    Site("cartpole", 1, "hinge_1", "hinge_1", "pole_1", False, 0.2, 0.036, 3.5, 1.0, 0.1, 3.1416, 1.0, 0.35),
    Site("acrobot", 0, "shoulder", "shoulder", "upper_arm", False, 4.0, 1.0, 2.5, 19.6, 1.0, 3.1416, 0.7, 2.6),
    Site("acrobot", 1, "elbow", "elbow", "lower_arm", False, 1.5, 0.12, 3.5, 9.8, 1.0, 0.0, 1.0, 1.6),
)
SYSTEMS = tuple(dict.fromkeys(site.system for site in SITES))
"""Of the benchmark: not all that the library has, for one more would change the cases of every seed."""


def sites(system: str) -> tuple[Site, ...]:
    """Those of a system, in the order of its joints."""
    return tuple(s for s in SITES if s.system == system)
