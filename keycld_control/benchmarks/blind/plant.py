"""The fine simulation: MuJoCo's Runge-Kutta steps of one millisecond, with forces injected step by step.

Smooth forces are taken at the middle of the step, which is predicted. Dry friction is exact: a joint that comes to rest
within a step stops there, and stays unless the other forces exceed what holds it (event-driven Coulomb friction; a few
Gauss-Seidel sweeps where several joints have it). Nothing is shared with the effects of the environments or the
diagnosis.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.blind.mechanism import ORDER, Array, CaseMechanism, DryFriction, Motor, Run, StepState

STEP = 1e-3
"""Time step, s."""
BEFORE = 100
"""Steps that are simulated before the first sample, in which the first command holds."""
SWEEPS = 4
"""Gauss-Seidel sweeps over the joints with dry friction."""
Controller = Callable[[int, Array], Array]
"""Commands `[nu]` at a tick, for what the sensors show then `[nv]`."""


@dataclass(frozen=True)
class PlantTrajectory:
    """A simulated run.

    Attributes:
        start: time of the first state, s.
        q: `[N, nv]` positions every `STEP`.
        v: `[N, nv]` velocities.
        commands: `[ticks, nu]`.
    """

    start: float
    q: Array
    v: Array
    commands: Array

    def at(self, t: Array) -> Array:
        """Positions `[T, nv]` at times, by cubic Hermite interpolation."""
        x = (t - self.start) / STEP
        k = np.clip(x.astype(int), 0, len(self.q) - 2)
        s = (x - k)[:, None]
        q0, q1, v0, v1 = self.q[k], self.q[k + 1], self.v[k] * STEP, self.v[k + 1] * STEP
        return (1 + 2 * s) * (1 - s) ** 2 * q0 + s * (1 - s) ** 2 * v0 + s**2 * (3 - 2 * s) * q1 + s**2 * (s - 1) * v1


class CasePlant:
    """A mechanism with the physics that the simulator lacks, in steps of one millisecond.

    Attributes:
        model: with masses and lengths as they are.
        mechanisms: physics that the simulator lacks.
    """

    def __init__(self, model: mujoco.MjModel, mechanisms: Sequence[CaseMechanism] = ()) -> None:
        self.model, self.mechanisms = copy.copy(model), tuple(mechanisms)
        option = self.model.opt
        option.timestep, option.integrator, option.enableflags = STEP, mujoco.mjtIntegrator.mjINT_RK4, 0
        option.disableflags = int(option.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        for mechanism in self.mechanisms:
            mechanism.edit(self.model)
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def measured_times(self, t: Array) -> Array:
        """Times of the motion that the sensors show at times `[T]`, s."""
        for mechanism in self.mechanisms:
            t = mechanism.measured_times(t)
        return t

    def simulate(
        self,
        q: Array,
        v: Array,
        ticks: NDArray[np.int64],
        controller: Controller,
        rng: np.random.Generator,
        duration: float,
        fastest: float = np.inf,
    ) -> PlantTrajectory | None:
        """One run.

        Args:
            q: `[nv]` positions `BEFORE` steps before time zero.
            v: `[nv]` velocities.
            ticks: steps at which commands change; the first is zero, and its command held before.
            controller: of the commands.
            rng: for what mechanisms draw anew in each run.
            duration: s.
            fastest: greatest speed of any joint, rad/s or m/s.

        Returns:
            The run; None if it gets faster than that.
        """
        model = copy.copy(self.model)
        data = mujoco.MjData(model)
        run, nv = Run(model, data, rng, duration), model.nv
        last = int(np.ceil(max(self.measured_times(np.array([duration]))[0], duration) / STEP)) + 2
        path_q, path_v = np.empty((BEFORE + last + 1, nv)), np.empty((BEFORE + last + 1, nv))
        for mechanism in self.mechanisms:
            q = mechanism.start(q)
        data.qpos[:], data.qvel[:] = q, v
        advance = _Advance(run, self.mechanisms)
        commands, upcoming = np.zeros((len(ticks), model.nu)), [*ticks.tolist(), last + 1]
        due = 0
        for k in range(-BEFORE, last + 1):
            path_q[k + BEFORE], path_v[k + BEFORE] = data.qpos, data.qvel
            if (k >= upcoming[due]) or (k == -BEFORE):
                if due or k == -BEFORE:
                    shown = np.clip(int(self.measured_times(np.array([k * STEP]))[0] / STEP), -BEFORE, k)
                    commands[due] = controller(due, path_q[int(shown) + BEFORE])
                    advance.now.u = commands[due].tolist()
                due += k >= 0
            if advance.step(k * STEP) > fastest:
                return None
        return PlantTrajectory(-BEFORE * STEP, path_q, path_v, commands)


class _Advance:
    """Steps of one run, one after the other."""

    def __init__(self, run: Run, mechanisms: Sequence[CaseMechanism]) -> None:
        self.run, model = run, run.model
        self.now = StepState(model.nv, model.nu, STEP)
        joints = [int(model.jnt_dofadr[model.actuator_trnid[i, 0]]) for i in range(model.nu)]
        chains: list[list[Motor]] = [[] for _ in joints]
        for m in sorted(mechanisms, key=lambda m: ORDER.index(m.id) if m.id in ORDER else len(ORDER)):
            if (motor := m.motor(run)) is not None:
                chains[m.actuator].append(motor)
        gears = {m.actuator: gear for m in mechanisms if (gear := m.transmission(run)) is not None}
        self.motors = [(i, j, float(model.actuator_gear[i, 0]), chains[i], gears.get(i)) for i, j in enumerate(joints)]
        self.forces = [force for m in mechanisms if (force := m.force(run)) is not None]
        self.pushes = [push for m in mechanisms if (push := m.push(run)) is not None]
        self.alterations = [alter for m in mechanisms if (alter := m.alter(run)) is not None]
        self.dry: dict[int, list[DryFriction]] = {}
        for m in mechanisms:
            if (dry := m.dry_friction(run)) is not None:
                self.dry.setdefault(m.joint, []).append(dry)
        self.gravity = model.opt.gravity.copy()
        mujoco.mj_forward(model, run.data)
        self.now.a = run.data.qacc.tolist()
        self.before = [0.0] * model.nv  # all forces of the step before
        self.mass = np.zeros((model.nv, model.nv))

    def step(self, t: float) -> float:
        """Advance from time t (s) by a step; returns the greatest speed before it."""
        now, data = self.now, self.run.data
        q, v, a, half = data.qpos.tolist(), data.qvel.tolist(), self.now.a, 0.5 * STEP
        now.t = t + half
        now.q = [x + half * y + 0.5 * half * half * z for x, y, z in zip(q, v, a, strict=True)]
        now.v = [y + half * z for y, z in zip(v, a, strict=True)]
        now.f = f = [0.0] * len(q)
        for alter in self.alterations:
            alter(now.t)
        for i, j, gear, chain, transmission in self.motors:
            u = now.u[i]
            for motor in chain:
                u = motor(now.t, u)
            f[j] += gear * u if transmission is None else transmission(now, gear * u)
        for force in self.forces:
            force(now)
        if self.pushes:
            x, z = map(sum, zip(*(push(now.t) for push in self.pushes), strict=True))
            self.run.model.opt.gravity[:] = self.gravity[0] - x, self.gravity[1], self.gravity[2] - z
        if self.dry:
            f = self._with_dry_friction(v, a, f)
        data.qfrc_applied[:] = f
        self.before = f
        mujoco.mj_step(self.run.model, data)
        now.a = [(x - y) / STEP for x, y in zip(data.qvel.tolist(), v, strict=True)]
        return max(map(abs, v))

    def _with_dry_friction(self, v: list[float], a: list[float], f: list[float]) -> list[float]:
        """Forces with dry friction, averaged over the step."""
        mujoco.mj_fullM(self.run.model, self.run.data, self.mass)
        inverse = _inverse(self.mass.tolist())
        before = self.before
        size = range(len(f))
        free = [a[i] + sum(inverse[i][j] * (f[j] - before[j]) for j in size) for i in size]
        limits = {
            j: [sum(side) for side in zip(*(dry(self.now) for dry in acting), strict=True)]
            for j, acting in self.dry.items()
        }
        friction = [0.0] * len(f)
        for _ in range(SWEEPS if len(limits) > 1 else 1):
            for j, (forward, backward) in limits.items():
                other = free[j] + sum(inverse[j][i] * friction[i] for i in limits if i != j)
                friction[j] = _mean_dry_friction(v[j], other, inverse[j][j], forward, backward)
        return [x + y for x, y in zip(f, friction, strict=True)]


def _inverse(m: list[list[float]]) -> list[list[float]]:
    if len(m) == 1:
        return [[1 / m[0][0]]]
    if len(m) == 2:
        (a, b), (c, d) = m
        det = a * d - b * c
        return [[d / det, -b / det], [-c / det, a / det]]
    return np.linalg.inv(m).tolist()


def _mean_dry_friction(v: float, a: float, mobility: float, forward: float, backward: float) -> float:
    """Mean dry friction over a step, for the speed at its start, and the acceleration without friction."""
    impulse, left = 0.0, STEP
    if v != 0:
        slide = -forward if v > 0 else backward
        accelerated = a + mobility * slide
        if (v + STEP * accelerated) * v > 0:
            return slide
        stopped = min(STEP, -v / accelerated)
        impulse, left = slide * stopped, STEP - stopped
    hold = -a / mobility
    return (impulse + left * min(max(hold, -forward), backward)) / STEP
