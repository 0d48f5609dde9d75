"""Many short rollouts of variants of a MuJoCo model at once."""

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.constants import update_constants
from keycld_envs.effects import Effect
from keycld_envs.effects.base import TransmissionEffect
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation import nuisance
from keycld_model.diagnosis.simulation.model_pool import ModelPool
from keycld_model.diagnosis.simulation.nuisance import Nuisance
from keycld_model.rigid_body.effects import Pushing, compiles, memories
from keycld_model.rigid_body.engine import Copies, MujocoRollouts, Rollouts
from keycld_model.rigid_body.mechanism import Mechanism

Array = NDArray[np.float64]
TOGETHER = 32
"""Rollouts at once; each may need a copy of the model, and copies are large."""
BEFORE = 1000
"""Steps for which the first command has held before a recording, for motors that remember; not for integrators."""


@dataclass(frozen=True)
class Pulse:
    """A push from outside.

    Attributes:
        recording: index.
        dof: joint, among the velocities.
        start: s, on the recording's clock.
        duration: s.
        force: N m or N, at most.
        rounded: half a sine instead of a rectangle.
    """

    recording: int
    dof: int
    start: float
    duration: float
    force: float
    rounded: bool = False

    def impulse(self, t: Array) -> Array:
        """From its start to times, N m s or N s."""
        since = np.clip(t - self.start, 0.0, self.duration)
        if not self.rounded:
            return self.force * since
        return self.force * self.duration / np.pi * (1 - np.cos(np.pi * since / self.duration))


@dataclass(frozen=True)
class Variant:
    """A simulator with other numbers and other physics.

    Attributes:
        values: of the nuisances.
        effects: added physics.
        pulses: pushes from outside, in the recordings that are simulated.
        starts: `[R, M]` what effects remember at the start of each recording, beyond where they begin; see `unsettled`.
        jumps: `[W, J]` what rotors do at the start of each window that is simulated, beyond what the recording before
            it says; see `rotors`.
    """

    values: Array
    effects: tuple[Effect, ...] = ()
    pulses: tuple[Pulse, ...] = ()
    starts: Array | None = None
    jumps: Array | None = None

    def elsewhere(self) -> "Variant":
        """On other recordings."""
        return replace(self, pulses=(), starts=None, jumps=None)

    def with_effects(self, *effects: Effect) -> "Variant":
        """With these instead; rotors that stay are where they were."""
        jumps = self.jumps
        if jumps is not None:
            here = {effect.key: self.jumps_of(effect, len(jumps)) for effect in rotors(self.effects)}
            kept = [here.get(e.key, np.zeros((len(jumps), e.memory))) for e in rotors(effects)]
            jumps = np.concatenate(kept, axis=1) if kept else None
        return replace(self, effects=effects, starts=None, jumps=jumps)

    def jumps_of(self, effect: Effect, windows: int) -> Array:
        """Of one of the effects, `[W, memory]`."""
        if self.jumps is None or not isinstance(effect, TransmissionEffect):
            return np.zeros((windows, effect.memory))
        first = sum(e.memory for e in itertools.takewhile(lambda e: e is not effect, rotors(self.effects)))
        return self.jumps[:, first : first + effect.memory]

    def starts_of(self, effect: Effect, recordings: int) -> Array:
        """Of one of the effects, `[R, memory]`."""
        if self.starts is None:
            return np.zeros((recordings, effect.memory))
        before = itertools.takewhile(lambda e: e is not effect, self.effects)
        first = sum(len(e.unsettled) for e in before)
        return self.starts[:, first : first + effect.memory]


def unsettled(effects: Sequence[Effect]) -> Array:
    """Standard deviations of what effects remember at the start of a recording, `[M]`."""
    return np.array([spread for effect in effects for spread in effect.unsettled])


def rotors(effects: Sequence[Effect]) -> list[TransmissionEffect]:
    """Effects with one: it swings fast, and where it is follows only roughly from how the joint was seen to move."""
    return [effect for effect in effects if isinstance(effect, TransmissionEffect)]


class Simulator:
    """Rollouts of a MuJoCo model of hinges and slides.

    Attributes:
        model: as it is believed to be.
        step: seconds.
        own: with the model's integrator and time step.
        tracked: positions are read off images.
        nuisances: what may be refitted.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        step: float | None = None,
        threads: int = 2,
        compiled: bool = True,
        tracked: bool = False,
    ) -> None:
        """With Runge-Kutta steps of `step` seconds, or with the model's own integrator and time step.

        `tracked` in images of a camera are the positions.
        """
        self.model, self.own, self.tracked = copy.copy(model), step is None, tracked
        if step is not None:
            self.model.opt.timestep, self.model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
        self.model.opt.enableflags = 0
        self.step = float(self.model.opt.timestep)
        self.nuisances: tuple[Nuisance, ...] = nuisance.nuisances(model, tracked)
        self._data = mujoco.MjData(self.model)
        self._models = ModelPool(self.model)
        self._remembered: dict[int, tuple[Array, Array]] = {}
        self._mujoco = MujocoRollouts(self.model, threads)
        self._fast = Mechanism.of(self.model, stops=not self.own) if compiled else None

    def with_step(self, step: float, compiled: bool = True) -> "Simulator":
        """The same with Runge-Kutta steps of so many seconds."""
        return Simulator(self.model, step, compiled=compiled, tracked=self.tracked)

    def compile(self, variant: Variant) -> mujoco.MjModel:
        """The model of a variant, as far as MuJoCo has its effects itself."""
        return self._changed(copy.copy(self.model), variant)

    def _changed(self, model: mujoco.MjModel, variant: Variant) -> mujoco.MjModel:
        nuisance.apply(model, self.nuisances, variant.values)
        for effect in variant.effects:
            effect.edit(model)
        update_constants(model, self._data)
        return model

    def simulate(
        self,
        variants: Sequence[Variant],
        which: NDArray[np.int64],
        windows: Windows,
        q: Array,
        v: Array,
        pushes: Array | None = None,
    ) -> Array:
        """Measured positions as variants predict them.

        Args:
            variants: V of them.
            which: `[P]` variant of each rollout of all windows.
            windows: W windows.
            q: `[P, W, nv]` positions at their starts.
            v: `[P, W, nv]` velocities.
            pushes: `[P, W, S, nv]` generalised forces from outside, held over each step.

        Returns:
            `[P, W, n, nv]`; NaN where a rollout diverges.
        """
        if len(which) > TOGETHER:
            parts = [slice(i, i + TOGETHER) for i in range(0, len(which), TOGETHER)]
            return np.concatenate(
                [
                    self.simulate(variants, which[p], windows, q[p], v[p], None if pushes is None else pushes[p])
                    for p in parts
                ]
            )
        used, which = np.unique(which, return_inverse=True)
        variants = [variants[i] for i in used]
        positions, velocities, _ = self.roll(variants, which, windows, q, v, pushes)
        begun = windows.begun[:, None]
        since = windows.time - windows.start[:, None] + begun
        shown = [_shown(variant, since) - _shown(variant, begun) for variant in variants]
        out = np.empty((len(which), *windows.measured.shape))
        for p, i in enumerate(which):
            at = _hermite(positions[p], velocities[p], shown[i], self.step)
            out[p] = nuisance.seen(self.model, self.nuisances, variants[i].values, *at)
        return out

    def roll(
        self,
        variants: Sequence[Variant],
        which: NDArray[np.int64],
        windows: Windows,
        q: Array,
        v: Array,
        pushes: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Positions and velocities `[P, W, S+1, nv]` at the steps, and what motors get, `[P, W, S, nu]`."""
        models = [
            self._changed(model, variant)
            for model, variant in zip(self._models.take(len(variants)), variants, strict=True)
        ]
        filtered = [self._filtered(variant, windows) for variant in variants]
        late = [(_shown(variant, windows.begun) - windows.begun) / self.step for variant in variants]
        commands = np.stack([_pieces(*some, windows) for some in zip(filtered, late, strict=True)])[which]
        forces = np.zeros((*commands.shape[:-1], self.model.nv)) if pushes is None else pushes
        if any(variant.pulses for variant in variants):
            forces = forces + np.stack([self._pushes(variant, windows) for variant in variants])[which]
        start, control = np.concatenate([q, v], axis=-1), np.concatenate([commands, forces], axis=-1)
        motors = np.stack([self._motors(commands, windows) for commands in filtered]) if self._remembers else None
        path = np.empty((*start.shape[:2], windows.steps + 1, start.shape[2]))
        path[:, :, 0] = start

        pushing = self._pushing(variants, models, filtered, windows)

        def run(by: Rollouts, rows: NDArray[np.int64]) -> None:
            """Step by step where effects push that are not in a program."""
            outside = [[e for e in p.effects if by is self._mujoco or not compiles(e)] for p in pushing]
            stepped = np.array([bool(outside[i]) for i in which[rows]])
            for some, by_hand in ((rows[stepped], True), (rows[~stepped], False)):
                if len(some):
                    begun = None if motors is None else motors[which[some]]
                    march = self._march(
                        by, models, pushing, which[some], windows, start[some], control[some], by_hand, begun
                    )
                    path[some, :, 1:] = march

        run(self._fast or self._mujoco, np.arange(len(which)))
        if self._fast and len(stopped := np.flatnonzero(self._beyond(path).any(axis=1))):
            run(self._mujoco, stopped)
        nv = self.model.nv
        return path[..., :nv], path[..., nv:], commands

    def _beyond(self, path: Array) -> NDArray[np.bool_]:
        """Rollouts that meet a limit of a joint, which only MuJoCo steps; `[P, W]`."""
        model, off = self.model, mujoco.mjtDisableBit
        limited = np.flatnonzero(model.jnt_limited)
        if not len(limited) or int(model.opt.disableflags) & (int(off.mjDSBL_CONSTRAINT) | int(off.mjDSBL_LIMIT)):
            return np.zeros(path.shape[:2], dtype=bool)
        margin = model.jnt_margin[limited]
        low, high = model.jnt_range[limited].T
        at = path[..., limited]
        return ((at < low + margin) | (at > high - margin)).any(axis=(2, 3))

    def _march(
        self,
        by: Rollouts,
        models: Sequence[mujoco.MjModel],
        pushing: Sequence[Pushing],
        which: NDArray[np.int64],
        windows: Windows,
        start: Array,
        control: Array,
        by_hand: bool,
        begun: Array | None,
    ) -> Array:
        """Positions and velocities after every step, `[P, W, S, 2 nv]`.

        `by_hand`, effects push step by step, each force held over a step at its value in the middle. `begun` are
        states `[P, W, size]` to begin with, but for positions and velocities.
        """
        (p, w, s, _), nv, nu, h = control.shape, self.model.nv, self.model.nu, self.step
        state = np.zeros((p * w, by.size)) if begun is None else begun.reshape(p * w, by.size).copy()
        of, window = np.repeat(which, w), np.tile(np.arange(w), p)
        state[:, by.motion] = start.reshape(p * w, -1)
        clock = np.tile(windows.begun, p)
        if not by_hand:
            present = [some if i in which else Pushing() for i, some in enumerate(pushing)]
            path = by.run(by.batch(Copies(models, present, of, window)), state, control.reshape(p * w, s, -1), clock)
            return path[..., by.motion].reshape(p, w, s, -1)
        out = np.empty((p, w, s, 2 * nv))
        batch = by.batch(Copies(models, [Pushing()] * len(models), of, window))
        rows = {i: np.flatnonzero(which == i) for i in np.unique(which)}
        acting = [(i, effect) for i in rows for effect in pushing[i].effects]
        memories = [np.repeat(m[None], len(rows[i]), axis=0) for i in rows for m in pushing[i].memories]
        time, before = windows.begun + h / 2, start[..., nv:]
        for k in range(s):
            now = state[:, by.motion].reshape(p, w, -1)
            q, v = now[..., :nv], now[..., nv:]
            gain = (v - before) / h
            middle_q, middle_v, before = q + 0.5 * h * v + 0.125 * h**2 * gain, v + 0.5 * h * gain, v.copy()
            here = control[:, :, k].copy()
            for m, (i, effect) in enumerate(acting):
                r = rows[i]
                then = np.broadcast_to(time + k * h, (len(r), w))
                force, memories[m] = effect.advance(
                    models[i], memories[m], then, middle_q[r], middle_v[r], here[r, :, :nu], h
                )
                here[r, :, nu:] += force
            state = by.run(batch, state, here.reshape(p * w, 1, -1), clock)[:, 0]
            out[:, :, k] = state[:, by.motion].reshape(p, w, -1)
        return out

    @property
    def _remembers(self) -> bool:
        """Whether the model's own motors remember earlier commands; such models are left to MuJoCo."""
        return bool(self.model.na or np.any(self.model.actuator_delay))

    def _motors(self, commands: Sequence[Array], windows: Windows) -> Array:
        """States of MuJoCo `[W, size]` at the starts of windows, as far as earlier commands determine them."""
        out, data = np.zeros((len(windows), self._mujoco.size)), self._data
        for r, u in enumerate(commands):
            mine = np.flatnonzero(windows.recording == r)
            if (known := self._remembered.get(id(u))) is None or known[0] is not u:
                states = np.empty((len(u), self._mujoco.size))
                mujoco.mj_resetData(self.model, data)
                integrates = np.any(self.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR)
                for k in [*[0] * (0 if integrates else BEFORE), *range(len(u))]:
                    data.qpos[:], data.qvel[:], data.ctrl[:] = self.model.qpos0, 0.0, u[k]
                    mujoco.mj_getState(self.model, data, states[k], mujoco.mjtState.mjSTATE_FULLPHYSICS)
                    mujoco.mj_step(self.model, data)
                known = u, states
                if any(u is own for own in windows.commands):
                    self._remembered[id(u)] = known
            out[mine] = known[1][windows.first[mine]]
        return out

    def _pushes(self, variant: Variant, windows: Windows) -> Array:
        """Mean forces of pulses over each step, `[W, S, nv]`."""
        out = np.zeros((len(windows), windows.steps, self.model.nv))
        edges = windows.start[:, None] + self.step * np.arange(windows.steps + 1)
        for pulse in variant.pulses:
            of = windows.recording == pulse.recording
            out[of, :, pulse.dof] += np.diff(pulse.impulse(edges[of]), axis=1) / self.step
        return out

    def _filtered(self, variant: Variant, windows: Windows) -> list[Array]:
        """What motors get, per recording, `[N, nu]`."""
        filtered = list(windows.commands)
        for effect in variant.effects:
            filtered = [effect.command(self.model, u, self.step) for u in filtered]
        return filtered

    def _pushing(
        self,
        variants: Sequence[Variant],
        models: Sequence[mujoco.MjModel],
        filtered: Sequence[list[Array]],
        windows: Windows,
    ) -> list[Pushing]:
        """Effects that push, and what they remember of the recordings before each window."""
        pushing = [tuple(effect for effect in variant.effects if effect.forces) for variant in variants]
        out = [[np.zeros((len(windows), effect.memory)) for effect in some] for some in pushing]
        kinds: dict[tuple[str, str], list[tuple[int, int]]] = {}
        for i, some in enumerate(pushing):
            for e, effect in enumerate(some):
                if effect.memory:
                    kinds.setdefault(effect.key, []).append((i, e))
        if kinds:
            longest = max(map(len, windows.commands))
            speeds = np.stack([_padded(v, longest) for v in windows.speeds], axis=1)  # [T, R, nv]
        for at in kinds.values():
            effects: list[Any] = [pushing[i][e] for i, e in at]
            motor = np.zeros((longest, len(at), len(windows.commands)))
            if isinstance(effects[0], TransmissionEffect):
                for row, (i, _) in enumerate(at):
                    torques = [effects[row].torque_of(models[i], u) for u in filtered[i]]
                    motor[:, row] = np.stack([_padded(torque, longest) for torque in torques], axis=1)
            starts = np.stack([variants[i].starts_of(pushing[i][e], motor.shape[2]) for i, e in at])
            path = memories(effects, motor, speeds[..., effects[0].dof(self.model)], starts, self.step)
            for row, (i, e) in enumerate(at):
                jumps = variants[i].jumps_of(pushing[i][e], len(windows))
                out[i][e] = path[windows.first, row, windows.recording] + jumps
        return [Pushing(some, tuple(memory)) for some, memory in zip(pushing, out, strict=True)]


def _shown(variant: Variant, t: Array) -> Array:
    """Times of the motion that sensors show at times."""
    for effect in variant.effects:
        t = effect.observe(t)
    return t


def _pieces(commands: Sequence[Array], late: Array, windows: Windows) -> Array:
    """What motors get in windows that start so many steps after their own start, `[W, S, nu]`."""
    first = windows.first + late
    whole, part = np.floor(first).astype(int), (first % 1.0)[:, None, None]
    out = np.empty((len(windows), windows.steps + 1, commands[0].shape[1]))
    for row, r, k in zip(out, windows.recording, whole, strict=True):
        row[:] = commands[r][np.clip(np.arange(k, k + len(row)), 0, len(commands[r]) - 1)]
    return (1 - part) * out[:, :-1] + part * out[:, 1:]


def _padded(values: Array, length: int) -> Array:
    """With the last row again and again."""
    return np.concatenate([values, np.repeat(values[-1:], length - len(values), axis=0)])


def usual_forces(model: mujoco.MjModel) -> Array:
    """Small but noticeable forces on the joints, N m or N, `[nv]`."""
    return 0.2 * model.dof_M0


def _hermite(q: Array, v: Array, time: Array, step: float) -> tuple[Array, Array]:
    """Positions and velocities at times `[W, n]` between steps, from those at steps, `[W, S+1, nv]`."""
    k = np.clip((time / step).astype(int), 0, q.shape[1] - 2)
    s = (time / step - k)[..., None]
    row = np.arange(len(q))[:, None]
    q0, q1, v0, v1 = q[row, k], q[row, k + 1], v[row, k] * step, v[row, k + 1] * step
    at = (1 + 2 * s) * (1 - s) ** 2 * q0 + s * (1 - s) ** 2 * v0 + s**2 * (3 - 2 * s) * q1 + s**2 * (s - 1) * v1
    return at, ((1 - s) * v0 + s * v1) / step
