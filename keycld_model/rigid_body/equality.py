"""Closed loops: bodies that are joined, and joints that are geared, as MuJoCo does it.

Its equality constraints are soft: accelerations a minimise |a - a0|^2 / 2 in the metric of the mass matrix M plus
|J a - r|^2 / 2 R (MuJoCo's documentation, "Computation"), so that a constraint adds J'J / R to M and J'r / R to forces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.rigid_body.scalars import add, cross, minus, mul, plus, subtract, turned

Array = NDArray[np.float64]
LOOP = 15
"""Numbers per loop: two anchors, or a polynomial and two references; seven of the impedance, and a usual inertia."""
_GEOMETRY = 7
_OFF = mujoco.mjtDisableBit
_CONNECT, _JOINT = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_JOINT)


@dataclass(frozen=True)
class Loop:
    """Two bodies that share a point, or two joints of which one follows the other.

    Attributes:
        joins: bodies rather than joints.
        index: among the model's equalities.
        one: body or joint; -1 is the world.
        two: the other; -1 is the world, or no joint.
    """

    joins: bool
    index: int
    one: int
    two: int

    def numbers(self, model: mujoco.MjModel) -> Array:
        """`[LOOP]`."""
        i, refsafe = self.index, not int(model.opt.disableflags) & int(_OFF.mjDSBL_REFSAFE)
        if self.joins:
            geometry = [*np.concatenate(anchors(model, i)), 0.0]
            inertia = sum(model.body_invweight0[body + 1, 0] for body in (self.one, self.two))
        else:
            joints = [j for j in (self.one, self.two) if j >= 0]
            references = [model.qpos0[model.jnt_qposadr[j]] for j in joints]
            geometry = [*model.eq_data[i, :5], *references, *[0.0] * (2 - len(joints))]
            inertia = sum(model.dof_invweight0[model.jnt_dofadr[j]] for j in joints)
        least, most, width, middle, power = model.eq_solimp[i]
        least, most, middle = np.clip([least, most, middle], 1e-4, 0.9999)
        time, damping = model.eq_solref[i]
        time = max(time, 2 * model.opt.timestep) if refsafe else time
        stiffness = 1 / (most * time * damping) ** 2
        shape = least, most, max(width, 1e-15), middle, max(power, 1.0)
        return np.array([*geometry, *shape, stiffness, 2 / (most * time), inertia])


class Row(NamedTuple):
    """One equation of a loop.

    Attributes:
        along: its derivative with respect to each joint, `[nv]`.
        aim: acceleration along it that closes the loop.
        regular: how soft it is.
    """

    along: list[Any]
    aim: Any
    regular: Any


def loops_of(model: mujoco.MjModel) -> tuple[Loop, ...] | None:
    """Those of a model that are closed at first; None if one is of another kind, which only MuJoCo can step."""
    off = int(_OFF.mjDSBL_CONSTRAINT) | int(_OFF.mjDSBL_EQUALITY)
    if int(model.opt.disableflags) & off:
        return ()
    out = []
    for i in np.flatnonzero(model.eq_active0):
        one, two, kind = int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), int(model.eq_type[i])
        if kind not in (_CONNECT, _JOINT) or model.eq_solref[i, 0] <= 0:
            return None
        if kind == _JOINT:
            out.append(Loop(False, int(i), one, two))
        else:
            a, b = bodies(model, int(i))
            out.append(Loop(True, int(i), a - 1, b - 1))
    return tuple(out)


def connections(model: mujoco.MjModel) -> list[int]:
    """Equalities that join bodies."""
    return [int(i) for i in np.flatnonzero(model.eq_type == _CONNECT)]


def bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """The bodies that a connection joins, the world being 0."""
    one, two = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == int(mujoco.mjtObj.mjOBJ_SITE):
        return int(model.site_bodyid[one]), int(model.site_bodyid[two])
    return one, two


def anchors(model: mujoco.MjModel, equality: int) -> tuple[Array, Array]:
    """Views of the points that a connection joins, `[3]` in the frames of their bodies."""
    if model.eq_objtype[equality] == int(mujoco.mjtObj.mjOBJ_SITE):
        return model.site_pos[model.eq_obj1id[equality]], model.site_pos[model.eq_obj2id[equality]]
    return model.eq_data[equality, :3], model.eq_data[equality, 3:6]


def rows_of(loop: Loop, numbers: Any, frames: Sequence[Any], q: Any, v: Any) -> list[Row]:
    """Equations of a loop.

    Args:
        loop: which.
        numbers: `[LOOP, N]`.
        frames: per body, and the world at last, how it is turned, where it is, how it spins, how that and its place
            accelerate if joints do not, and its joints: index, axis, anchor.
        q: positions `[nv, N]`.
        v: velocities.
    """
    nv = len(q)
    if loop.joins:
        points, rates, motions = [], [], []
        for body, anchor in ((loop.one, numbers[:3]), (loop.two, numbers[3:6])):
            turn, origin, spin, spin_rate, rate, moving = frames[body]
            arm = turned(turn, tuple(anchor))
            point = plus(origin, arm)
            points.append(point)
            rates.append(plus(rate, plus(cross(spin_rate, arm), cross(spin, cross(spin, arm)))))
            motions.append({j: axis if hub is None else cross(axis, minus(point, hub)) for j, axis, hub in moving})
        zero = (0.0, 0.0, 0.0)
        columns = [minus(motions[0].get(j, zero), motions[1].get(j, zero)) for j in range(nv)]
        gap, drift = minus(*points), minus(*rates)
        size = jnp.sqrt(sum(mul(x, x) for x in gap) + 1e-300)
        lines = [[column[i] for column in columns] for i in range(3)]
    else:
        (c0, c1, c2, c3, c4), references = numbers[:5], numbers[5:7]
        x = q[loop.two] - references[1] if loop.two >= 0 else jnp.zeros_like(q[0])
        along: list[Any] = [0.0] * nv
        along[loop.one] = 1.0
        if loop.two >= 0:
            along[loop.two] = -(c1 + x * (2 * c2 + x * (3 * c3 + x * 4 * c4)))
        gap = (q[loop.one] - references[0] - (c0 + x * (c1 + x * (c2 + x * (c3 + x * c4)))),)
        size, lines, drift = jnp.abs(gap[0]), [along], (0.0,)  # as MuJoCo has it
    least, most, width, middle, power, stiffness, damping, inertia = numbers[_GEOMETRY:]
    impedance = _impedance(size / width, least, most, middle, power)
    regular = jnp.maximum((1 - impedance) / impedance * inertia, 1e-15)
    out = []
    for off, rate, line in zip(gap, drift, lines, strict=True):
        aim = subtract(mul(-damping, _along(line, v)), mul(stiffness * impedance, off))
        out.append(Row(line, subtract(aim, rate), regular))
    return out


def _impedance(x: Any, least: Any, most: Any, middle: Any, power: Any) -> Any:
    """From the violation over its width."""
    x = jnp.clip(x, 0.0, 1.0)
    low = x**power / middle ** (power - 1)
    high = 1 - (1 - x) ** power / (1 - middle) ** (power - 1)
    return least + jnp.where(x <= middle, low, high) * (most - least)


def _along(line: Sequence[Any], values: Any) -> Any:
    """Dot product with a value per joint."""
    out: Any = 0.0
    for a, b in zip(line, values, strict=True):
        out = add(out, mul(a, b))
    return out


def tightened(mass: list[list[Any]], force: list[Any], rows: Sequence[Row]) -> tuple[list[list[Any]], list[Any]]:
    """Mass matrix and forces with the loops in them."""
    mass, force = [list(row) for row in mass], list(force)
    for along, aim, regular in rows:
        for i, a in enumerate(along):
            force[i] = add(force[i], mul(a, aim / regular))
            for j, b in enumerate(along):
                mass[i][j] = add(mass[i][j], mul(mul(a, b), 1 / regular))
    return mass, force


def pulls(rows: Sequence[Row], acceleration: Any) -> list[Any]:
    """Forces of the loops on the joints, at accelerations `[nv, N]`."""
    out: list[Any] = [0.0] * len(acceleration)
    for along, aim, regular in rows:
        pull = subtract(aim, _along(along, acceleration)) / regular
        out = [add(force, mul(a, pull)) for force, a in zip(out, along, strict=True)]
    return out
