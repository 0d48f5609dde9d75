"""Thousands of short rollouts of a tree of hinges and slides at once, as MuJoCo steps it, compiled by JAX.

A search needs many millions of steps; `examples/rollout_speed.py` compares with MuJoCo's own batched rollouts.
Equations: Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 2 and 6; integrators, and dry friction with the
model's own one, as in MuJoCo's documentation ("Computation"). Accurate steps have dry friction that stops a joint, and
holds it, where MuJoCo's soft constraint creeps: after a reversal that is milliradians, more than sensors' noise.
Everything is written in single numbers, each an array over the rollouts, so that what is zero by construction costs
nothing.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.rigid_body.effects import Slots, smooth_numbers
from keycld_model.rigid_body.engine import Copies
from keycld_model.rigid_body.equality import LOOP, Loop, loops_of, pulls, rows_of, tightened
from keycld_model.rigid_body.scalars import (
    Vector,
    add,
    cross,
    dot,
    minus,
    mul,
    plus,
    product,
    rotation,
    scaled,
    solve,
    turned,
)

Array = NDArray[np.float64]
CHUNK, PIECE = 128, 40
"""Rollouts, and steps at most, that are simulated together: any other numbers would be compiled anew."""
MOST_JOINTS = 6
SWEEPS = 12
"""Of Gauss-Seidel, over joints with dry friction that hold each other."""
BODY, JOINT, MOTOR = 10, 11, 9
"""Numbers per body, joint and motor."""
_OFF = mujoco.mjtDisableBit


@dataclass(frozen=True)
class Joint:
    """A hinge or slide; axis and anchor in the body's frame."""

    slides: bool
    axis: Vector
    anchor: Vector
    reference: float


@dataclass(frozen=True)
class Body:
    """A rigid body; what is zero in `shape` stays zero."""

    parent: int
    joints: tuple[int, ...]
    turn: tuple[Vector, Vector, Vector]
    principal: tuple[Vector, Vector, Vector]
    shape: tuple[bool, ...]


@dataclass(frozen=True)
class Mechanism:
    """What of a model no variant changes.

    Attributes:
        bodies: without the world; a parent comes before its children.
        joints: of all bodies.
        motors: joint of each.
        loops: that are closed.
        runge_kutta: the integrator; semi-implicit Euler with implicit damping otherwise.
        stops: dry friction stops a joint, and holds it, instead of MuJoCo's soft constraint.
    """

    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    motors: tuple[int, ...]
    loops: tuple[Loop, ...]
    runge_kutta: bool
    stops: bool

    @classmethod
    def of(cls, model: mujoco.MjModel, stops: bool = False) -> "Mechanism | None":
        """None for models with what only MuJoCo can step: contacts, tendons, welds, motors with a memory."""
        loops = loops_of(model)
        if loops is None or not _in_scope(model):
            return None
        joints = tuple(
            Joint(
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
            bodies.append(Body(int(model.body_parentid[b]) - 1, own, *turns, nonzero))
        motors = tuple(int(model.actuator_trnid[i, 0]) for i in range(model.nu))
        runge_kutta = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        return cls(tuple(bodies), joints, motors, loops, bool(runge_kutta), stops)

    @property
    def length(self) -> int:
        """How many numbers variants may change, K."""
        return sum(rows * width for rows, width in self.shapes) + 3

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Rows and numbers per row of bodies, joints, motors and loops; gravity comes after them."""
        return (len(self.bodies), BODY), (len(self.joints), JOINT), (len(self.motors), MOTOR), (len(self.loops), LOOP)

    def bearing(self, joint: int) -> int:
        """The body that a joint moves."""
        return next(b for b, body in enumerate(self.bodies) if joint in body.joints)

    def numbers(self, model: mujoco.MjModel) -> Array:
        """What variants may change, `[K]`."""
        flags = int(model.opt.disableflags)
        on = {name: not flags & int(getattr(_OFF, f"mjDSBL_{name}")) for name in _FLAGS}
        bodies = [model.body_mass[1:, None], model.body_ipos[1:], model.body_inertia[1:], model.body_pos[1:]]
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
        force = np.stack([model.actuator_gainprm[:, 0], *model.actuator_biasprm[:, :3].T], axis=1) * on["ACTUATION"]
        clamps = model.actuator_ctrllimited.astype(bool) & on["CLAMPCTRL"], model.actuator_forcelimited.astype(bool)
        ranges = [
            np.where(limited[:, None], limits, [-np.inf, np.inf])
            for limited, limits in zip(clamps, (model.actuator_ctrlrange, model.actuator_forcerange), strict=True)
        ]
        motors = np.concatenate([model.actuator_gear[:, :1], force, *ranges], axis=1)
        gravity = model.opt.gravity * on["GRAVITY"]
        rows = np.concatenate(bodies, axis=1), np.concatenate(joints).T, motors
        return np.concatenate([*(r.ravel() for r in rows), *(loop.numbers(model) for loop in self.loops), gravity])

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return 2 * len(self.joints)

    @property
    def motion(self) -> slice:
        """Where positions and velocities are in it."""
        return slice(0, self.size)

    def batch(self, copies: Copies) -> "Batch":
        """See `Rollouts`."""
        everything = [effect for some in copies.pushing for effect in some.effects]
        slots, windows = Slots.of(copies.models[0], everything), int(copies.window.max()) + 1
        rows = [
            np.concatenate([self.numbers(model), slots.numbers(some.effects)])
            for model, some in zip(copies.models, copies.pushing, strict=True)
        ]
        memory = np.stack([slots.remembered(some, windows) for some in copies.pushing])[copies.of, copies.window]
        numbers, step = np.stack(rows)[copies.of], float(copies.models[0].opt.timestep)
        with jax.enable_x64(True):
            chunks = [(jnp.asarray(numbers[some].T), jnp.asarray(memory[some].T)) for some in _chunks(len(numbers))]
        return Batch(slots, chunks, smooth_numbers(everything), step)

    def run(self, batch: "Batch", state: Array, control: Array, time: Array) -> Array:
        """See `Rollouts`."""
        (n, steps, _), roll = control.shape, self._programs(batch.slots)
        out, at = np.empty((n, steps, self.size)), 0
        with jax.enable_x64(True):
            for (numbers, memory), some in zip(batch.chunks, _chunks(n), strict=True):
                motion, used = _Motion.begin(state[some].T, memory, time[some]), min(CHUNK, n - at)
                for begin in range(0, steps, PIECE):
                    end = min(begin + PIECE, steps)
                    commands = np.zeros((PIECE, control.shape[2], CHUNK))
                    commands[: end - begin] = np.moveaxis(control[some, begin:end], 0, -1)
                    motion, path = roll(numbers, motion, commands, end - begin, batch.step, batch.smooth)
                    out[at : at + used, begin:end] = np.moveaxis(np.asarray(path)[: end - begin], -1, 0)[:used]
                at += used
        return out

    @functools.cached_property
    def _programs(self) -> Callable[[Slots], Any]:
        """By their slots."""
        return _programs(self)


@dataclass(frozen=True)
class Batch:
    """Rollouts, in chunks of one size.

    Attributes:
        slots: for effects.
        chunks: numbers `[K, N]` of the mechanism and of effects, and what effects remember at first, `[M, N]`.
        smooth: of a residual force.
        step: s.
    """

    slots: Slots
    chunks: list[tuple[Any, Any]]
    smooth: tuple[Any, ...]
    step: float


class _Motion(NamedTuple):
    """Where N rollouts are.

    Attributes:
        q: `[nv, N]`.
        v: `[nv, N]`.
        before: velocities one step before.
        memory: `[M, N]` of effects.
        time: `[N]` s, for effects.
    """

    q: Any
    v: Any
    before: Any
    memory: Any
    time: Any

    @classmethod
    def begin(cls, state: Any, memory: Any, time: Any) -> "_Motion":
        """From states `[2 nv, N]`."""
        q, v = np.split(state, 2)
        return cls(q, v, v, memory, time)


def _chunks(number: int) -> list[NDArray[np.int64]]:
    """Indices in pieces of one size, the last one filled up."""
    return [np.minimum(np.arange(at, at + CHUNK), number - 1) for at in range(0, number, CHUNK)]


_FLAGS = ("CONSTRAINT", "FRICTIONLOSS", "GRAVITY", "SPRING", "DAMPER", "ACTUATION", "CLAMPCTRL", "REFSAFE")


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
        and 0 < model.njnt <= MOST_JOINTS
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


def _clean(values: Array) -> Vector:
    """Floats, without rounding errors of zero and one."""
    near = np.where(np.abs(values - np.round(values)) < 1e-12, np.round(values), values)
    return tuple(float(x) + 0.0 for x in near)  # pyright: ignore[reportReturnType]


def _matrix(quaternion: Array) -> tuple[Vector, Vector, Vector]:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return tuple(_clean(row) for row in matrix.reshape(3, 3))  # pyright: ignore[reportReturnType]


@functools.lru_cache(maxsize=8)
def _programs(mechanism: Mechanism) -> Callable[[Slots], Any]:
    """Programs of equal mechanisms, see `_program`.

    The last ones used: each takes memory, and some of the mappings of which a process may have 65,530 on Linux.
    """
    return functools.lru_cache(maxsize=32)(functools.partial(_program, mechanism))


class _Numbers(NamedTuple):
    """What variants may change, of N rollouts.

    Attributes:
        bodies: `[nb, BODY, N]`.
        joints: `[nv, JOINT, N]`.
        motors: `[nu, MOTOR, N]`.
        loops: `[nl, LOOP, N]`.
        gravity: three times `[N]`.
        friction: `[nv, N]` dry friction of joints.
    """

    bodies: Any
    joints: Any
    motors: Any
    loops: Any
    gravity: Any
    friction: Any


def _split(mechanism: Mechanism, numbers: Any) -> _Numbers:
    """Of `[K, N]`."""
    ends = np.cumsum([rows * width for rows, width in mechanism.shapes])
    *parts, gravity = jnp.split(numbers, ends)
    bodies, joints, motors, loops = (
        part.reshape(*shape, numbers.shape[1]) for part, shape in zip(parts, mechanism.shapes, strict=True)
    )
    return _Numbers(bodies, joints, motors, loops, tuple(gravity), joints[:, 8])


def _program(mechanism: Mechanism, slots: Slots) -> Any:
    """For numbers `[K, N]`, where rollouts are, control `[S, nu + nv, N]`, how many steps are wanted, and seconds each.

    Gives where the rollouts are then, and their states `[S, 2 nv, N]`.
    """
    step, nu = _runge_kutta if mechanism.runge_kutta else _euler, len(mechanism.motors)

    def roll(numbers: Any, motion: _Motion, control: Any, steps: Any, h: Any, smooth: Any) -> Any:
        mine, others = jnp.split(numbers, [mechanism.length])
        own, acting = _split(mechanism, mine), slots.acting(others, smooth)

        def advance(i: Any, carry: Any) -> Any:
            (q, v, before, memory, t), path = carry
            u, here, middle, gain = control[i], own, t + h / 2, (v - before) / h
            half_q, half_v = q + 0.5 * h * v + 0.125 * h**2 * gain, v + 0.5 * h * gain
            if slots.slots:
                bodies, gravity = acting.surroundings(own.bodies, own.gravity, middle)
                friction = acting.rubbed(own.friction, half_q, half_v, _loads(mechanism, own, half_q, half_v, u))
                here = own._replace(bodies=bodies, gravity=gravity, friction=friction)
                force, memory = acting.forces(memory, middle, half_q, half_v, u[:nu], _motors(here, u), h)
                u = jnp.concatenate([u[:nu], u[nu:] + force])
            if mechanism.stops:
                u = jnp.concatenate([u[:nu], u[nu:] + _stopping(mechanism, here, half_q, half_v, u, v, h)])
            after, speed = step(mechanism, here, (q, v), u, h)
            return _Motion(after, speed, v, memory, t + h), path.at[i].set(jnp.concatenate([after, speed]))

        path = jnp.zeros((len(control), mechanism.size, numbers.shape[1]))
        return jax.lax.fori_loop(0, steps, advance, (motion, path))

    return jax.jit(roll)


def _motors(numbers: _Numbers, u: Any) -> Callable[[int], Any]:
    """Torques of actuators that do nothing but multiply."""
    return lambda i: numbers.motors[i, 0] * numbers.motors[i, 1] * u[i]


def _loads(mechanism: Mechanism, numbers: _Numbers, q: Any, v: Any, u: Any) -> Callable[[int], Any]:
    """Forces in the bearings of joints, of a slide across its rail, without forces from outside."""

    def load(j: int) -> Any:
        alone = jnp.concatenate([u[: len(mechanism.motors)], jnp.zeros_like(v)])
        acceleration = _acceleration(mechanism, numbers, q, v, alone)
        moving = _mass_and_bias(mechanism, numbers, q, v)[2]
        beyond, force = {mechanism.bearing(j)}, (0.0, 0.0, 0.0)
        for b, body in enumerate(mechanism.bodies):
            if b in beyond or body.parent in beyond:
                beyond.add(b)
                push, columns = moving[b]
                force = plus(force, push)
                for i, straight, _ in columns:
                    force = plus(force, scaled(numbers.bodies[b, 0] * acceleration[i], straight))
        if mechanism.joints[j].slides:
            axis = next(straight for i, straight, _ in moving[mechanism.bearing(j)][1] if i == j)
            force = minus(force, scaled(dot(force, axis), axis))
        return jnp.sqrt(dot(force, force) + 1e-30)

    return load


def _runge_kutta(mechanism: Mechanism, numbers: _Numbers, state: Any, u: Any, h: Any) -> Any:
    """The classical one, of fourth order."""
    q, v = state

    def stage(carry: Any, weights: Any) -> Any:
        before, total = carry
        ahead, share = weights
        here = q + h * ahead * before[0], v + h * ahead * before[1]
        slope = here[1], _acceleration(mechanism, numbers, *here, u)
        return (slope, jax.tree.map(lambda t, s: t + share * s, total, slope)), None

    zero = jnp.zeros_like(q), jnp.zeros_like(v)
    weights = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6
    (_, total), _ = jax.lax.scan(stage, (zero, zero), weights, unroll=2)
    return q + h * total[0], v + h * total[1]


def _euler(mechanism: Mechanism, numbers: _Numbers, state: Any, u: Any, h: Any) -> Any:
    """Semi-implicit, with implicit damping."""
    q, v = state
    v = v + h * _acceleration(mechanism, numbers, q, v, u, implicit=h)
    return q + h * v, v


def _acceleration(mechanism: Mechanism, numbers: _Numbers, q: Any, v: Any, u: Any, implicit: Any = None) -> Any:
    """`[nv, N]`; `implicit` in damping over so many seconds, as a step of Euler's needs it.

    Without dry friction if that stops joints: the steps are given its mean.
    """
    nv, joints = len(mechanism.joints), numbers.joints
    mass, force, slope, rows = _balance(mechanism, numbers, q, v, u)
    tight, pulled = tightened(mass, force, rows)
    if mechanism.stops and implicit is None:
        return jnp.stack(solve(tight, pulled))
    rubbed = _friction(tight, pulled, [(numbers.friction[j], *joints[j, 9:]) for j in range(nv)], v)
    acceleration = jnp.stack(solve(tight, [add(f, r) for f, r in zip(pulled, rubbed, strict=True)]))
    if implicit is None:
        return acceleration
    for j in range(nv):
        mass[j][j] = mass[j][j] + implicit * slope[j]
    forces = zip(force, rubbed, pulls(rows, acceleration), strict=True)
    return jnp.stack(solve(mass, [add(add(f, r), p) for f, r, p in forces]))


def _balance(
    mechanism: Mechanism, numbers: _Numbers, q: Any, v: Any, u: Any
) -> tuple[list[list[Any]], list[Any], list[Any], list[Any]]:
    """Mass matrix, forces on joints but dry friction, what damping grows by with speed, and rows of closed loops."""
    nv, nu, joints = len(mechanism.joints), len(mechanism.motors), numbers.joints
    mass, bias, _, frames = _mass_and_bias(mechanism, numbers, q, v)
    slope, force = [], []
    for j in range(nv):
        b0, b1, b2, armature, k0, k1, k2, rest = joints[j, :8]
        mass[j][j] = add(mass[j][j], armature)
        speed, x = jnp.abs(v[j]), q[j] - rest
        spring = x * (k0 + x * (k1 + x * k2))
        force.append(u[nu + j] - v[j] * (b0 + speed * (b1 + speed * b2)) - spring - bias[j])
        slope.append(b0 + speed * (2 * b1 + speed * 3 * b2))
    for i, j in enumerate(mechanism.motors):
        gear, gain, f0, f1, f2, low, high, least, most = numbers.motors[i]
        torque = gain * jnp.clip(u[i], low, high) + f0 + f1 * gear * q[j] + f2 * gear * v[j]
        force[j] = force[j] + gear * jnp.clip(torque, least, most)
    rows = [
        row
        for loop, own in zip(mechanism.loops, numbers.loops, strict=True)
        for row in rows_of(loop, own, frames, q, v)
    ]
    return mass, force, slope, rows


def _stopping(mechanism: Mechanism, numbers: _Numbers, q: Any, v: Any, u: Any, begun: Any, h: Any) -> Any:
    """Mean dry friction `[nv, N]` over a step, for positions and velocities in its middle, and velocities at first.

    A joint slides until it stops, and is held from then on unless the other forces exceed what holds it.
    """
    nv, most = len(mechanism.joints), numbers.friction

    def rubbing() -> Any:
        mass, force, _, rows = _balance(mechanism, numbers, q, v, u)
        tight, pulled = tightened(mass, force, rows)
        free, one = solve(tight, pulled), jnp.ones_like(begun[0])
        given = [solve(tight, [one if i == j else 0.0 for j in range(nv)]) for i in range(nv)]

        def sweep(rubbed: Any, _: None) -> tuple[Any, None]:
            forces = list(rubbed)
            for j in range(nv):
                others = functools.reduce(add, [mul(given[i][j], forces[i]) for i in range(nv) if i != j], free[j])
                forces[j] = _stopped(begun[j], others, given[j][j], most[j], h)
            return jnp.stack(forces), None

        return jax.lax.scan(sweep, -most * jnp.sign(begun), None, length=SWEEPS if nv > 1 else 1)[0]

    return jax.lax.cond(jnp.any(most > 0), rubbing, lambda: jnp.zeros_like(begun))


def _stopped(v: Any, others: Any, mobility: Any, most: Any, h: Any) -> Any:
    """Mean dry friction over a step for the speed at its start, and the acceleration without; all `[N]`."""
    slide, hold = -most * jnp.sign(v), jnp.clip(-others / mobility, -most, most)
    change = others + mobility * slide
    stops = v * (v + h * change) <= 0
    time = jnp.where(stops & (change != 0), jnp.clip(-v / jnp.where(change == 0, 1.0, change), 0.0, h), 0.0)
    return jnp.where(stops, (slide * time + hold * (h - time)) / h, slide)


def _friction(mass: list[list[Any]], force: list[Any], joints: Sequence[Any], v: Any) -> list[Any]:
    """Dry friction of the joints: MuJoCo's soft constraint, by Newton steps on which joints slip."""
    nv = len(force)
    stop = [-damping * v[j] for j, (_, _, damping) in enumerate(joints)]

    def rub(acceleration: Any) -> tuple[list[Any], list[Any]]:
        """Forces, and whether each joint sticks."""
        wanted = [(stop[j] - acceleration[j]) / regular for j, (_, regular, _) in enumerate(joints)]
        forces = [jnp.clip(w, -most, most) for w, (most, _, _) in zip(wanted, joints, strict=True)]
        return forces, [jnp.abs(w) < most for w, (most, _, _) in zip(wanted, joints, strict=True)]

    def accelerate(rubbed: list[Any], sticks: list[Any]) -> Any:
        stiff, right = [list(row) for row in mass], []
        for j, (_, regular, _) in enumerate(joints):
            stiff[j][j] = stiff[j][j] + jnp.where(sticks[j], 1 / regular, 0.0)
            right.append(force[j] + jnp.where(sticks[j], stop[j] / regular, rubbed[j]))
        return jnp.stack(solve(stiff, right))

    def newton(acceleration: Any, _: None) -> tuple[Any, None]:
        return accelerate(*rub(acceleration)), None

    def rubbing() -> Any:
        free = solve(mass, force)
        given = [solve(mass, [jnp.ones_like(v[0]) if i == j else 0.0 for j in range(nv)]) for i in range(nv)]

        def relax(rubbed: Any, _: None) -> tuple[Any, None]:
            """A sweep of projected Gauss-Seidel."""
            forces = list(rubbed)
            for j, (most, regular, _) in enumerate(joints):
                acceleration = free[j] + functools.reduce(add, [mul(given[i][j], forces[i]) for i in range(nv)])
                change = (stop[j] - acceleration - regular * forces[j]) / (given[j][j] + regular)
                forces[j] = jnp.clip(forces[j] + change, -most, most)
            return jnp.stack(forces), None

        rubbed, _ = jax.lax.scan(relax, jnp.zeros_like(v), None, length=2 * nv)  # finds which joints stick
        first = jnp.stack(solve(mass, [f + r for f, r in zip(force, rubbed, strict=True)]))
        acceleration, _ = jax.lax.scan(newton, first, None, length=2)  # exact then
        return jnp.stack(rub(acceleration)[0])

    anywhere = functools.reduce(jnp.logical_or, [jnp.any(joint[0] > 0) for joint in joints])
    return list(jax.lax.cond(anywhere, rubbing, lambda: jnp.zeros_like(v)))


def _mass_and_bias(
    mechanism: Mechanism, numbers: _Numbers, q: Any, v: Any
) -> tuple[list[list[Any]], list[Any], list[Any], list[Any]]:
    """Mass matrix, the force that holds all joints at constant speed, of each body the same and its joints, and frames.

    A body's joints are their index, and how its middle moves, and how it turns, at unit speed; frames are those of
    `rows_of`.
    """
    nv = len(mechanism.joints)
    mass: list[list[Any]] = [[0.0] * nv for _ in range(nv)]
    bias: list[Any] = [0.0] * nv
    zero, eye = (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    up = tuple(-g for g in numbers.gravity)
    world = eye, zero, zero, zero, zero, up, ()
    frames: list[Any] = []
    held: list[Any] = []
    for b, body in enumerate(mechanism.bodies):
        m, *rest = (numbers.bodies[b, i] if there else 0.0 for i, there in enumerate(body.shape))
        centre, inertia, place = tuple(rest[:3]), rest[3:6], tuple(rest[6:])
        turn, origin, spin, speed, spin_rate, rate, moving = frames[body.parent] if body.parent >= 0 else world

        def ride(arm: Any, spin: Any, spin_rate: Any) -> Any:
            """Velocity and acceleration of a point relative to another of the same body."""
            swing = cross(spin, arm)
            return swing, plus(cross(spin_rate, arm), cross(spin, swing))

        def move(arm: Any, origin: Any, speed: Any, rate: Any, spin: Any, spin_rate: Any) -> Any:
            swing, swing_rate = ride(arm, spin, spin_rate)
            return plus(origin, arm), plus(speed, swing), plus(rate, swing_rate)

        origin, speed, rate = move(turned(turn, place), origin, speed, rate, spin, spin_rate)
        turn = product(turn, body.turn)
        for j in body.joints:
            joint = mechanism.joints[j]
            axis, angle = turned(turn, joint.axis), q[j] - joint.reference
            if joint.slides:
                origin, speed, rate = move(scaled(angle, axis), origin, speed, rate, spin, spin_rate)
                speed = plus(speed, scaled(v[j], axis))
                rate = plus(rate, scaled(2 * v[j], cross(spin, axis)))
                moving = (*moving, (j, axis, None))
                continue
            anchor, speed, rate = move(turned(turn, joint.anchor), origin, speed, rate, spin, spin_rate)
            spin_rate = plus(spin_rate, scaled(v[j], cross(spin, axis)))
            spin = plus(spin, scaled(v[j], axis))
            turn = product(turn, rotation(joint.axis, angle))
            back = scaled(-1.0, turned(turn, joint.anchor))
            origin, speed, rate = move(back, anchor, speed, rate, spin, spin_rate)
            moving = (*moving, (j, axis, anchor))
        frames.append((turn, origin, spin, speed, spin_rate, rate, moving))
        middle, _, push = move(turned(turn, centre), origin, speed, rate, spin, spin_rate)
        principal = product(turn, body.principal)

        def heavy(w: Any, principal: Any = principal, inertia: Any = inertia) -> Any:
            """Inertia times a rotation."""
            along = tuple(mul(inertia[i], dot(tuple(row[i] for row in principal), w)) for i in range(3))
            return turned(principal, along)

        twist = plus(heavy(spin_rate), cross(spin, heavy(spin)))
        push = scaled(m, push)
        columns = [
            (j, axis if anchor is None else cross(axis, minus(middle, anchor)), zero if anchor is None else axis)
            for j, axis, anchor in moving
        ]
        held.append((push, columns))
        for i, straight, round_ in columns:
            bias[i] = add(bias[i], add(dot(straight, push), dot(round_, twist)))
            pulled, swung = scaled(m, straight), heavy(round_)
            for j, other, other_round in columns:
                if j <= i:
                    mass[i][j] = add(mass[i][j], add(dot(other, pulled), dot(other_round, swung)))
    for i in range(nv):
        for j in range(i):
            mass[j][i] = mass[i][j]
    return mass, bias, held, [(*frame[:3], *frame[4:]) for frame in (*frames, world)]
