"""How a body stands and moves: frames, carried along a tree from joint to joint."""

from typing import NamedTuple

from keycld_model.rigid_body.scalars import (
    Matrix,
    Traced,
    Vector,
    cross,
    plus,
    product,
    rotation,
    scaled,
    turned,
)
from keycld_model.rigid_body.tree import TreeJoint


class Axis(NamedTuple):
    """A joint in the world.

    Attributes:
        joint: its index.
        direction: of its axis.
        anchor: a point of its axis, m; None for a slide.
    """

    joint: int
    direction: Vector
    anchor: Vector | None


class Frame(NamedTuple):
    """How a body stands, how it moves, and how it would accelerate if all joints kept their speeds, in the world.

    Attributes:
        turn: rotation to the world.
        origin: m.
        spin: angular velocity, rad/s.
        velocity: of its origin, m/s.
        spin_rate: angular acceleration, rad/s^2.
        acceleration: of its origin, m/s^2.
        axes: of the joints that carry it.
    """

    turn: Matrix
    origin: Vector
    spin: Vector
    velocity: Vector
    spin_rate: Vector
    acceleration: Vector
    axes: tuple[Axis, ...]

    def moved(self, arm: Vector) -> "Frame":
        """The frame at another point of the same body, an arm away in the world."""
        swing = cross(self.spin, arm)
        swing_rate = plus(cross(self.spin_rate, arm), cross(self.spin, swing))
        return self._replace(
            origin=plus(self.origin, arm),
            velocity=plus(self.velocity, swing),
            acceleration=plus(self.acceleration, swing_rate),
        )

    def across(self, joint: TreeJoint, j: int, q: Traced, v: Traced) -> "Frame":
        """The frame behind joint j, for positions and velocities `[nv, N]`."""
        axis, amount = turned(self.turn, joint.axis), q[j] - joint.reference
        if joint.slides:
            slid = self.moved(scaled(amount, axis))
            velocity = plus(slid.velocity, scaled(v[j], axis))
            acceleration = plus(slid.acceleration, scaled(2 * v[j], cross(slid.spin, axis)))
            axes = (*self.axes, Axis(j, axis, None))
            return slid._replace(velocity=velocity, acceleration=acceleration, axes=axes)
        hub = self.moved(turned(self.turn, joint.anchor))
        spin_rate = plus(hub.spin_rate, scaled(v[j], cross(hub.spin, axis)))
        spin = plus(hub.spin, scaled(v[j], axis))
        turn = product(hub.turn, rotation(joint.axis, amount))
        behind = hub._replace(turn=turn, spin=spin, spin_rate=spin_rate, axes=(*self.axes, Axis(j, axis, hub.origin)))
        return behind.moved(scaled(-1.0, turned(turn, joint.anchor)))


_ZERO = (0.0, 0.0, 0.0)
ORIGIN = Frame(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, ())
"""The world's frame at rest."""
