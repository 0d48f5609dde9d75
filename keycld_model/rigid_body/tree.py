"""A tree of hinges and slides, read off a MuJoCo model: what of it no variant changes, and the numbers that they do."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.delan.rig import LearnedDynamics, deviation, learned_dynamics
from keycld_model.rigid_body.equality import LOOP, Loop, loops_of
from keycld_model.rigid_body.scalars import Constants

Array = NDArray[np.float64]
MOST_JOINTS = 6
"""Joints that a tree of bodies may have: compiling takes minutes beyond, for every entry of the mass matrix is written
out."""
BODY, JOINT, MOTOR = 10, 11, 9
"""Numbers per body, joint and motor.

Body: mass, centre of mass, principal moments of inertia, place in its parent. Joint: damping of order one to three in
speed, armature, stiffness of order one to three, where its spring rests, dry friction, and how soft and how damped the
constraint is that stands for it. Motor: gear, gain, three of its bias, limits of command and of force.
"""
_OFF = mujoco.mjtDisableBit
_FLAGS = ("CONSTRAINT", "FRICTIONLOSS", "GRAVITY", "SPRING", "DAMPER", "ACTUATION", "CLAMPCTRL", "REFSAFE")


@dataclass(frozen=True)
class TreeJoint:
    """A hinge or slide.

    Attributes:
        slides: it is a slide.
        axis: in the frame of its body.
        anchor: in the frame of its body, m.
        reference: position at which the body is where the model draws it, rad or m.
    """

    slides: bool
    axis: Constants
    anchor: Constants
    reference: float


@dataclass(frozen=True)
class TreeBody:
    """A rigid body.

    Attributes:
        parent: index of the body that carries it, -1 for the world.
        joints: indices of those that move it.
        turn: rotation from its frame to its parent's, before its joints turn.
        principal: rotation from its principal axes of inertia to its frame.
        nonzero: `[BODY]` which of its numbers are not zero; the others are zero in every variant.
    """

    parent: int
    joints: tuple[int, ...]
    turn: tuple[Constants, Constants, Constants]
    principal: tuple[Constants, Constants, Constants]
    nonzero: tuple[bool, ...]


@dataclass(frozen=True)
class RigidBodyTree:
    """What of a model no variant changes, and how it is stepped.

    Attributes:
        bodies: without the world; a parent comes before its children.
        joints: of all bodies.
        motors: joint of each.
        loops: that are closed.
        runge_kutta: the integrator; semi-implicit Euler with implicit damping otherwise.
        exact_stiction: dry friction stops a joint, and holds it, instead of MuJoCo's soft constraint.
        learned: what moves the joints in place of the bodies, in rigs of joint models.
    """

    bodies: tuple[TreeBody, ...]
    joints: tuple[TreeJoint, ...]
    motors: tuple[int, ...]
    loops: tuple[Loop, ...]
    runge_kutta: bool
    exact_stiction: bool
    learned: LearnedDynamics | None = None

    @classmethod
    def of(cls, model: mujoco.MjModel, exact_stiction: bool = False) -> "RigidBodyTree | None":
        """None for models with what only MuJoCo can step: contacts, tendons, welds, motors with a memory."""
        loops = loops_of(model)
        if loops is None or not _in_scope(model):
            return None
        joints = tuple(
            TreeJoint(
                bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE),
                _clean(model.jnt_axis[j]),
                _clean(model.jnt_pos[j]),
                float(model.qpos0[j]),
            )
            for j in range(model.njnt)
        )
        bodies = []
        for b in range(1, model.nbody):
            first = int(model.body_jntadr[b])
            own = tuple(range(first, first + int(model.body_jntnum[b])))
            numbers = np.concatenate([[1.0], model.body_ipos[b], np.ones(3), model.body_pos[b]])
            nonzero = tuple(bool(x) for x in np.abs(numbers) > 1e-12)
            turns = _matrix(model.body_quat[b]), _matrix(model.body_iquat[b])
            bodies.append(TreeBody(int(model.body_parentid[b]) - 1, own, *turns, nonzero))
        motors = tuple(int(model.actuator_trnid[i, 0]) for i in range(model.nu))
        runge_kutta = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        learned = learned_dynamics(model)
        return cls(tuple(bodies), joints, motors, loops, bool(runge_kutta), exact_stiction, learned)

    @property
    def length(self) -> int:
        """How many numbers variants may change, K."""
        return sum(rows * width for rows, width in self.shapes) + 3

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Rows and numbers per row of bodies, joints, motors, loops, and own errors; gravity comes after them."""
        own = 0 if self.learned is None else self.learned.deviations
        counts = len(self.bodies), len(self.joints), len(self.motors), len(self.loops), 1
        return tuple(zip(counts, (BODY, JOINT, MOTOR, LOOP, own), strict=True))

    @property
    def size(self) -> int:
        """Numbers of a state: positions and velocities."""
        return 2 * len(self.joints)

    def moved_by(self, joint: int) -> int:
        """Index of the body that a joint moves."""
        return next(b for b, body in enumerate(self.bodies) if joint in body.joints)

    def beyond(self, joint: int) -> list[int]:
        """Indices of the bodies that a joint carries."""
        out = {self.moved_by(joint)}
        for b, body in enumerate(self.bodies):
            if body.parent in out:
                out.add(b)
        return sorted(out)

    def numbers(self, model: mujoco.MjModel) -> Array:
        """What variants may change, `[K]`."""
        flags = int(model.opt.disableflags)
        on = {name: not flags & int(getattr(_OFF, f"mjDSBL_{name}")) for name in _FLAGS}
        bodies = [model.body_mass[1:, None], model.body_ipos[1:], model.body_inertia[1:], model.body_pos[1:]]
        gravity = model.opt.gravity * on["GRAVITY"]
        rows = np.concatenate(bodies, axis=1), _joint_numbers(model, on), _motor_numbers(model, on)
        own = [] if self.learned is None else deviation(model)
        loops = (loop.numbers(model) for loop in self.loops)
        return np.concatenate([*(r.ravel() for r in rows), *loops, own, gravity])


def _joint_numbers(model: mujoco.MjModel, on: dict[str, bool]) -> Array:
    """`[nv, JOINT]`."""
    friction = model.dof_frictionloss * (on["CONSTRAINT"] and on["FRICTIONLOSS"])
    impedance = np.clip(model.dof_solimp[:, :2], 1e-4, 0.9999)
    regular = np.maximum((1 - impedance[:, 0]) / impedance[:, 0] * model.dof_invweight0, 1e-15)
    safe = np.maximum(model.dof_solref[:, 0], 2 * model.opt.timestep if on["REFSAFE"] else 0.0)
    joints = [
        np.stack([model.dof_damping, *model.dof_dampingpoly.T]) * on["DAMPER"],
        model.dof_armature[None],
        np.stack([model.jnt_stiffness, *model.jnt_stiffnesspoly.T]) * on["SPRING"],
        model.qpos_spring[None],
        np.stack([friction, regular, 2 / (impedance[:, 1] * safe)]),
    ]
    return np.concatenate(joints).T


def _motor_numbers(model: mujoco.MjModel, on: dict[str, bool]) -> Array:
    """`[nu, MOTOR]`."""
    force = np.stack([model.actuator_gainprm[:, 0], *model.actuator_biasprm[:, :3].T], axis=1) * on["ACTUATION"]
    clamps = model.actuator_ctrllimited.astype(bool) & on["CLAMPCTRL"], model.actuator_forcelimited.astype(bool)
    ranges = [
        np.where(limited[:, None], limits, [-np.inf, np.inf])
        for limited, limits in zip(clamps, (model.actuator_ctrlrange, model.actuator_forcerange), strict=True)
    ]
    return np.concatenate([model.actuator_gear[:, :1], force, *ranges], axis=1)


def _in_scope(model: mujoco.MjModel) -> bool:
    """The model is a tree of hinges and slides, with motors that act on joints, and nothing that collides."""
    flags, kinds = int(model.opt.disableflags), mujoco.mjtJoint
    unconstrained = bool(flags & int(_OFF.mjDSBL_CONSTRAINT))

    def free_of(name: str) -> bool:
        return unconstrained or bool(flags & int(getattr(_OFF, f"mjDSBL_{name}")))

    velocity_bias = bool(model.nu and np.any(model.actuator_biasprm[:, 2]))
    rk4 = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    fast = model.opt.integrator in (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    damped = not flags & int(_OFF.mjDSBL_EULERDAMP)
    return bool(
        np.isin(model.jnt_type, [int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)]).all()
        and model.njnt > 0
        and (model.njnt <= MOST_JOINTS or learned_dynamics(model) is not None)
        and (rk4 or (fast and damped and not velocity_bias))
        and (free_of("CONTACT") or not may_collide(model))
        and model.ntendon == model.nflex == model.nplugin == model.na == 0
        and model.opt.density == 0 and model.opt.viscosity == 0
        and not np.any(model.body_gravcomp)
        and (model.dof_solref[:, 0] > 0).all()
        and not np.any(model.jnt_actfrclimited)
        and np.all(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        and np.all(model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED)
        and np.all(model.actuator_biastype <= int(mujoco.mjtBias.mjBIAS_AFFINE))
        and not np.any(model.actuator_damping) and not np.any(model.actuator_armature)
        and not np.any(model.actuator_delay)
    )  # fmt: skip


def may_collide(model: mujoco.MjModel) -> bool:
    """Whether any two geoms can touch, wherever they are."""
    body, one, two = model.geom_bodyid, model.geom_contype, model.geom_conaffinity
    weld, parent = model.body_weldid, model.body_parentid
    for a in range(model.ngeom):
        for b in range(a):
            if not (one[a] & two[b] or one[b] & two[a]):
                continue
            x, y = weld[body[a]], weld[body[b]]
            filtered = x and y and (weld[parent[x]] == y or weld[parent[y]] == x)
            if x != y and not filtered:
                return True
    return model.npair > 0


def _clean(values: Array) -> Constants:
    """Three numbers as floats, without rounding errors of zero and one."""
    x, y, z = np.where(np.abs(values - np.round(values)) < 1e-12, np.round(values), values)
    return float(x) + 0.0, float(y) + 0.0, float(z) + 0.0


def _matrix(quaternion: Array) -> tuple[Constants, Constants, Constants]:
    """Rotation of a quaternion."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    first, second, third = matrix.reshape(3, 3)
    return _clean(first), _clean(second), _clean(third)
