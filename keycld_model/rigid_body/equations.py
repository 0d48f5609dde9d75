"""Equations of motion of a tree of hinges and slides.

See Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 2 and 6.

Everything is written in single numbers, each an array over N rollouts, so that what is zero by construction costs
nothing; see `scalars`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from keycld_model.delan.rig import LearnedDynamics
from keycld_model.rigid_body.frames import ORIGIN, Axis, Frame
from keycld_model.rigid_body.friction import soft_friction
from keycld_model.rigid_body.loops import Row, pulls, rows_of, tightened
from keycld_model.rigid_body.scalars import (
    Matrix,
    Scalar,
    Traced,
    Vector,
    add,
    cross,
    dot,
    minus,
    mul,
    plus,
    product,
    scaled,
    solve,
    turned,
)
from keycld_model.rigid_body.tree import RigidBodyTree, TreeBody


class TreeNumbers(NamedTuple):
    """What variants may change, of N rollouts.

    Attributes:
        bodies: `[nb, BODY, N]`.
        joints: `[nv, JOINT, N]`.
        motors: `[nu, MOTOR, N]`.
        loops: `[nl, LOOP, N]`.
        deviation: `[1, K, N]` own errors of a joint model; none of bodies.
        gravity: three times `[N]`, m/s^2.
        friction: `[nv, N]` dry friction of joints, N m or N.
    """

    bodies: Traced
    joints: Traced
    motors: Traced
    loops: Traced
    deviation: Traced
    gravity: tuple[Traced, ...]
    friction: Traced

    @classmethod
    def of(cls, tree: RigidBodyTree, numbers: Traced) -> "TreeNumbers":
        """From `[K, N]`, see `RigidBodyTree.numbers`."""
        ends = np.cumsum([rows * width for rows, width in tree.shapes])
        *parts, gravity = jnp.split(numbers, ends)
        bodies, joints, motors, loops, deviation = (
            part.reshape(*shape, numbers.shape[1]) for part, shape in zip(parts, tree.shapes, strict=True)
        )
        return cls(bodies, joints, motors, loops, deviation, tuple(gravity), joints[:, 8])


class Column(NamedTuple):
    """How a body moves with one of its joints, at unit speed.

    Attributes:
        joint: its index.
        straight: velocity of the body's centre of mass.
        turning: angular velocity of the body.
    """

    joint: int
    straight: Vector
    turning: Vector


class CarriedBody(NamedTuple):
    """What moves a body.

    Attributes:
        force: on its centre of mass, N, if all joints keep their speeds; gravity counts as acceleration upwards.
        columns: of its joints.
    """

    force: Vector
    columns: list[Column]


class MassAndBias(NamedTuple):
    """Mass matrix and bias forces of joints.

    Attributes:
        mass: `[nv][nv]`.
        bias: `[nv]` forces that keep all joints at their speeds, N m or N.
        bodies: what moves each.
        frames: of each body, and of the world at last.
    """

    mass: list[list[Scalar]]
    bias: list[Scalar]
    bodies: list[CarriedBody]
    frames: list[Frame]


def mass_and_bias(tree: RigidBodyTree, numbers: TreeNumbers, q: Traced, v: Traced) -> MassAndBias:
    """Of joints at positions and velocities `[nv, N]`."""
    nv = len(tree.joints)
    if tree.learned is not None:
        return _learned(tree.learned, numbers, q, v)
    world = ORIGIN._replace(acceleration=_upwards(numbers.gravity))
    out = MassAndBias([[0.0] * nv for _ in range(nv)], [0.0] * nv, [], [])
    for b, body in enumerate(tree.bodies):
        m, *rest = (numbers.bodies[b, i] if there else 0.0 for i, there in enumerate(body.nonzero))
        x, y, z, *moments, px, py, pz = rest
        frame = out.frames[body.parent] if body.parent >= 0 else world
        frame = frame.moved(turned(frame.turn, (px, py, pz)))
        frame = frame._replace(turn=product(frame.turn, body.turn))
        for j in body.joints:
            frame = frame.across(tree.joints[j], j, q, v)
        out.frames.append(frame)
        out.bodies.append(_carry(out, frame, body, m, (x, y, z), moments))
    for i in range(nv):
        for j in range(i):
            out.mass[j][i] = out.mass[i][j]
    out.frames.append(world)
    return out


def _learned(learned: LearnedDynamics, numbers: TreeNumbers, q: Traced, v: Traced) -> MassAndBias:
    """What networks say, times the mass of the first body, and with the model's own errors."""
    mass, bias = learned.mass_and_bias(q, v, numbers.bodies[0, 0], numbers.deviation[0])
    return MassAndBias([list(row) for row in mass], list(bias), [], [])


def _upwards(gravity: tuple[Traced, ...]) -> Vector:
    """The acceleration that a frame at rest has in place of gravity."""
    x, y, z = gravity
    return -x, -y, -z


def _carry(
    out: MassAndBias, frame: Frame, body: TreeBody, m: Scalar, centre: Vector, moments: list[Scalar]
) -> CarriedBody:
    """Add the inertia of a body to the mass matrix and bias of the joints that carry it."""
    middle = frame.moved(turned(frame.turn, centre))
    principal = product(frame.turn, body.principal)

    def inertia_times(w: Vector) -> Vector:
        along = [mul(moments[i], dot(_column(principal, i), w)) for i in range(3)]
        return turned(principal, (along[0], along[1], along[2]))

    torque = plus(inertia_times(frame.spin_rate), cross(frame.spin, inertia_times(frame.spin)))
    force = scaled(m, middle.acceleration)
    columns = [_moving(axis, middle.origin) for axis in frame.axes]
    for i, straight, turning in columns:
        out.bias[i] = add(out.bias[i], add(dot(straight, force), dot(turning, torque)))
        momentum, angular = scaled(m, straight), inertia_times(turning)
        for j, other, other_turning in columns:
            if j <= i:
                out.mass[i][j] = add(out.mass[i][j], add(dot(other, momentum), dot(other_turning, angular)))
    return CarriedBody(force, columns)


def _column(matrix: Matrix, i: int) -> Vector:
    """Column i of a matrix."""
    return matrix[0][i], matrix[1][i], matrix[2][i]


def _moving(axis: Axis, centre: Vector) -> Column:
    """How a point moves with a joint."""
    if axis.anchor is None:
        return Column(axis.joint, axis.direction, (0.0, 0.0, 0.0))
    return Column(axis.joint, cross(axis.direction, minus(centre, axis.anchor)), axis.direction)


class Balance(NamedTuple):
    """Mass matrix, forces and constraints of joints; dry friction is not among them.

    Attributes:
        mass: `[nv][nv]` with armatures.
        force: `[nv]` on the joints, N m or N.
        slope: `[nv]` by how much damping grows with speed, N m s/rad or N s/m.
        rows: of closed loops.
    """

    mass: list[list[Scalar]]
    force: list[Scalar]
    slope: list[Scalar]
    rows: list[Row]

    def tightened(self) -> tuple[list[list[Scalar]], list[Scalar]]:
        """Mass matrix and forces with the loops in them."""
        return tightened(self.mass, self.force, self.rows)


def balance(tree: RigidBodyTree, numbers: TreeNumbers, q: Traced, v: Traced, u: Traced) -> Balance:
    """Of joints at positions and velocities `[nv, N]`, for commands and forces from outside `[nu + nv, N]`."""
    nv, nu, joints = len(tree.joints), len(tree.motors), numbers.joints
    mass, bias, _, frames = mass_and_bias(tree, numbers, q, v)
    slope, force = [], []
    for j in range(nv):
        b0, b1, b2, armature, k0, k1, k2, rest = joints[j, :8]
        mass[j][j] = add(mass[j][j], armature)
        speed, x = jnp.abs(v[j]), q[j] - rest
        spring = x * (k0 + x * (k1 + x * k2))
        force.append(u[nu + j] - v[j] * (b0 + speed * (b1 + speed * b2)) - spring - bias[j])
        slope.append(b0 + speed * (2 * b1 + speed * 3 * b2))
    motor = actuator_torque(tree, numbers, q, v, u)
    for i, j in enumerate(tree.motors):
        force[j] = force[j] + motor(i)
    rows = [
        row for loop, own in zip(tree.loops, numbers.loops, strict=True) for row in rows_of(loop, own, frames, q, v)
    ]
    return Balance(mass, force, slope, rows)


def acceleration(
    tree: RigidBodyTree, numbers: TreeNumbers, q: Traced, v: Traced, u: Traced, implicit: Traced | None = None
) -> Traced:
    """`[nv, N]`; `implicit` in damping over so many seconds, as a step of Euler's needs it.

    Without dry friction if that is exact stiction: the steps are given its mean.
    """
    nv, joints = len(tree.joints), numbers.joints
    mass, force, slope, rows = here = balance(tree, numbers, q, v, u)
    tight, pulled = here.tightened()
    if tree.exact_stiction and implicit is None:
        return jnp.stack(solve(tight, pulled))
    friction = soft_friction(tight, pulled, [(numbers.friction[j], *joints[j, 9:]) for j in range(nv)], v)
    out = jnp.stack(solve(tight, [add(f, r) for f, r in zip(pulled, friction, strict=True)]))
    if implicit is None:
        return out
    for j in range(nv):
        mass[j][j] = mass[j][j] + implicit * slope[j]
    forces = zip(force, friction, pulls(rows, out), strict=True)
    return jnp.stack(solve(mass, [add(add(f, r), p) for f, r, p in forces]))


def bearing_force(
    tree: RigidBodyTree, numbers: TreeNumbers, q: Traced, v: Traced, u: Traced
) -> Callable[[int], Traced]:
    """Force in the bearing of a joint, `[N]`, of a slide across its rail; without forces from outside."""

    def force_at(j: int) -> Traced:
        alone = jnp.concatenate([u[: len(tree.motors)], jnp.zeros_like(v)])
        gain = acceleration(tree, numbers, q, v, alone)
        bodies = mass_and_bias(tree, numbers, q, v).bodies
        force: Vector = (0.0, 0.0, 0.0)
        for b in tree.beyond(j):
            force = plus(force, bodies[b].force)
            for i, straight, _ in bodies[b].columns:
                force = plus(force, scaled(numbers.bodies[b, 0] * gain[i], straight))
        if tree.joints[j].slides:
            axis = next(straight for i, straight, _ in bodies[tree.moved_by(j)].columns if i == j)
            force = minus(force, scaled(dot(force, axis), axis))
        return jnp.sqrt(dot(force, force) + 1e-30)

    return force_at


def actuator_torque(
    tree: RigidBodyTree, numbers: TreeNumbers, q: Traced, v: Traced, u: Traced
) -> Callable[[int], Traced]:
    """Torque of an actuator at its joint, `[N]`, with what depends on position and speed, and within its limits."""

    def torque_of(i: int) -> Traced:
        j, (gear, gain, f0, f1, f2, low, high, least, most) = tree.motors[i], numbers.motors[i]
        torque = gain * jnp.clip(u[i], low, high) + f0 + f1 * gear * q[j] + f2 * gear * v[j]
        return gear * jnp.clip(torque, least, most)

    return torque_of


def motor_torque(numbers: TreeNumbers, u: Traced) -> Callable[[int], Traced]:
    """Torque of an actuator that does nothing but multiply its command, in joint coordinates, `[N]`."""
    return lambda i: numbers.motors[i, 0] * numbers.motors[i, 1] * u[i]
