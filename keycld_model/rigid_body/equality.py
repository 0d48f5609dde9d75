"""Closed loops of a MuJoCo model: bodies that are joined, and joints that are geared."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LOOP = 15
"""Numbers per loop: two anchors, or a polynomial and two references; seven of the impedance, and a usual inertia."""
GEOMETRY = 7
"""Of these, those that are no part of the impedance."""
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
