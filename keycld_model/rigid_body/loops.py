"""Equations of closed loops, as MuJoCo has them.

Its equality constraints are soft: accelerations a minimise |a - a0|^2 / 2 in the metric of the mass matrix M plus
|J a - r|^2 / 2 R (MuJoCo's documentation, "Computation"), so that a constraint adds J'J / R to M and J'r / R to forces.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from keycld_model.rigid_body.equality import GEOMETRY, Loop
from keycld_model.rigid_body.frames import Frame
from keycld_model.rigid_body.scalars import (
    Scalar,
    Traced,
    Vector,
    add,
    cross,
    minus,
    mul,
    plus,
    subtract,
    turned,
)


class Row(NamedTuple):
    """One equation of a loop.

    Attributes:
        along: its derivative with respect to each joint, `[nv]`.
        aim: acceleration along it that closes the loop.
        regular: how soft it is.
    """

    along: list[Scalar]
    aim: Scalar
    regular: Traced


class _Gap(NamedTuple):
    """How far a loop is open.

    Attributes:
        gap: of each equation, m or rad.
        size: of all, `[N]`.
        lines: derivatives of the gap of each equation with respect to each joint.
        drift: acceleration of the gap of each equation if all joints keep their speeds.
    """

    gap: Sequence[Scalar]
    size: Traced
    lines: list[list[Scalar]]
    drift: Sequence[Scalar]


def rows_of(loop: Loop, numbers: Traced, frames: Sequence[Frame], q: Traced, v: Traced) -> list[Row]:
    """Equations of a loop.

    Args:
        loop: which.
        numbers: `[LOOP, N]`.
        frames: per body, and the world at last.
        q: positions `[nv, N]`.
        v: velocities.
    """
    gap, size, lines, drift = _connection(loop, numbers, frames, len(q)) if loop.joins else _gear(loop, numbers, q)
    least, most, width, middle, power, stiffness, damping, inertia = numbers[GEOMETRY:]
    impedance = _impedance(size / width, least, most, middle, power)
    regular = jnp.maximum((1 - impedance) / impedance * inertia, 1e-15)
    out = []
    for off, rate, line in zip(gap, drift, lines, strict=True):
        aim = subtract(mul(-damping, _along(line, v)), mul(stiffness * impedance, off))
        out.append(Row(line, subtract(aim, rate), regular))
    return out


def _connection(loop: Loop, numbers: Traced, frames: Sequence[Frame], nv: int) -> _Gap:
    """Between points of two bodies."""
    points, rates, motions = [], [], []
    for body, anchor in ((loop.one, numbers[:3]), (loop.two, numbers[3:6])):
        frame = frames[body]
        x, y, z = anchor
        arm = turned(frame.turn, (x, y, z))
        point = plus(frame.origin, arm)
        points.append(point)
        swing = plus(cross(frame.spin_rate, arm), cross(frame.spin, cross(frame.spin, arm)))
        rates.append(plus(frame.acceleration, swing))
        motions.append(
            {j: axis if hub is None else cross(axis, minus(point, hub)) for j, axis, hub in frame.axes},
        )
    zero: Vector = (0.0, 0.0, 0.0)
    columns = [minus(motions[0].get(j, zero), motions[1].get(j, zero)) for j in range(nv)]
    gap, drift = minus(*points), minus(*rates)
    size = jnp.sqrt(sum(mul(x, x) for x in gap) + 1e-300)
    return _Gap(gap, size, [[column[i] for column in columns] for i in range(3)], drift)


def _gear(loop: Loop, numbers: Traced, q: Traced) -> _Gap:
    """Between a joint and where a polynomial in another puts it."""
    (c0, c1, c2, c3, c4), references = numbers[:5], numbers[5:7]
    x = q[loop.two] - references[1] if loop.two >= 0 else jnp.zeros_like(q[0])
    along: list[Scalar] = [0.0] * len(q)
    along[loop.one] = 1.0
    if loop.two >= 0:
        along[loop.two] = -(c1 + x * (2 * c2 + x * (3 * c3 + x * 4 * c4)))
    gap = q[loop.one] - references[0] - (c0 + x * (c1 + x * (c2 + x * (c3 + x * c4))))
    return _Gap((gap,), jnp.abs(gap), [along], (0.0,))  # without a drift, as MuJoCo has it


def _impedance(x: Traced, least: Traced, most: Traced, middle: Traced, power: Traced) -> Traced:
    """Of MuJoCo's constraints, from the violation over its width."""
    x = jnp.clip(x, 0.0, 1.0)
    low = x**power / middle ** (power - 1)
    high = 1 - (1 - x) ** power / (1 - middle) ** (power - 1)
    return least + jnp.where(x <= middle, low, high) * (most - least)


def _along(line: Sequence[Scalar], values: Traced) -> Scalar:
    """Dot product with a value per joint."""
    out: Scalar = 0.0
    for a, b in zip(line, values, strict=True):
        out = add(out, mul(a, b))
    return out


def tightened(
    mass: list[list[Scalar]], force: list[Scalar], rows: Sequence[Row]
) -> tuple[list[list[Scalar]], list[Scalar]]:
    """Mass matrix and forces with the loops in them."""
    mass, force = [list(row) for row in mass], list(force)
    for along, aim, regular in rows:
        for i, a in enumerate(along):
            force[i] = add(force[i], mul(a, aim / regular))
            for j, b in enumerate(along):
                mass[i][j] = add(mass[i][j], mul(mul(a, b), 1 / regular))
    return mass, force


def pulls(rows: Sequence[Row], acceleration: Traced) -> list[Scalar]:
    """Forces of the loops on the joints, at accelerations `[nv, N]`."""
    out: list[Scalar] = [0.0] * len(acceleration)
    for along, aim, regular in rows:
        pull = subtract(aim, _along(along, acceleration)) / regular
        out = [add(force, mul(a, pull)) for force, a in zip(out, along, strict=True)]
    return out
