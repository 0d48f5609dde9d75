"""Where mechanisms can be, how they are moved there, and what is large and small: one row per joint of each system."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Site:
    """One joint with its motor.

    Attributes:
        system: short name.
        joint: index.
        name: of the joint.
        motor: name of its actuator, which has the same index.
        body: name of the body that it moves.
        slide: whether it moves along a line; in that case, read N, kg, m and m/s for N m, kg m², rad and rad/s below.
        torque: typical of the motion, N m.
        inertia: felt by the motor, kg m².
        speed: typical, rad/s.
        load: weight that the joint carries, N.
        mass: of its body, kg.
        rest: stable position, rad.
        swing: how far the joint moves from there, rad.
        command: typical amplitude of commands.
        release: how far from its rest the joint is released, rad.
        stiffness: of the position controller, command per rad.
        damping: of the position controller, command per rad/s.
        target: how far from the rest set points of the position controller are, rad.
    """

    system: str
    joint: int
    name: str
    motor: str
    body: str
    slide: bool = False
    torque: float
    inertia: float
    speed: float
    load: float
    mass: float
    rest: float
    swing: float
    command: float
    release: float
    stiffness: float
    damping: float
    target: float


SITES = (
    Site(
        system="pendulum", joint=0, name="hinge", motor="torque", body="pole",
        torque=1.5, inertia=0.25, speed=3.0, load=9.8, mass=1.0, rest=3.1416, swing=1.2, command=0.9,
        release=2.2, stiffness=2.0, damping=0.6, target=1.4,
    ),
    Site(
        system="cartpole", joint=0, name="slider", motor="slide", body="cart", slide=True,
        torque=1.5, inertia=1.1, speed=1.0, load=10.8, mass=1.0, rest=0.0, swing=0.4, command=0.6,
        release=0.5, stiffness=2.0, damping=1.2, target=0.6,
    ),
    Site(
        system="cartpole", joint=1, name="hinge_1", motor="hinge_1", body="pole_1",
        torque=0.2, inertia=0.036, speed=3.5, load=1.0, mass=0.1, rest=3.1416, swing=1.0, command=0.35,
        release=2.0, stiffness=0.5, damping=0.12, target=1.0,
    ),
    Site(
        system="acrobot", joint=0, name="shoulder", motor="shoulder", body="upper_arm",
        torque=4.0, inertia=1.0, speed=2.5, load=19.6, mass=1.0, rest=3.1416, swing=0.7, command=2.6,
        release=1.4, stiffness=5.0, damping=2.5, target=0.6,
    ),
    Site(
        system="acrobot", joint=1, name="elbow", motor="elbow", body="lower_arm",
        torque=1.5, inertia=0.12, speed=3.5, load=9.8, mass=1.0, rest=0.0, swing=1.0, command=1.6,
        release=1.6, stiffness=3.0, damping=0.7, target=1.0,
    ),
)  # fmt: skip
SYSTEMS = tuple(dict.fromkeys(site.system for site in SITES))
"""Of the benchmark: not all that the library has, for one more would change the cases of every seed."""


def sites(system: str) -> tuple[Site, ...]:
    """The sites of a system, in the order of its joints."""
    return tuple(s for s in SITES if s.system == system)


def environment_of(system: str) -> str:
    """The id of a system's environment."""
    return f"KeyCLD/{system.capitalize()}-v0"
