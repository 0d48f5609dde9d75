"""Many short rollouts of variants of a MuJoCo model at once."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis import nuisance
from keycld_model.diagnosis.model_pool import ModelPool
from keycld_model.diagnosis.nuisance import Nuisance
from keycld_model.diagnosis.windows import Windows

Array = NDArray[np.float64]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
TOGETHER = 32
"""Rollouts at once; each may need a copy of the model, and copies are large."""
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


@dataclass(frozen=True)
class Pulse:
    """A push from outside.

    Attributes:
        recording: index.
        dof: joint, among the velocities.
        start: s, on the recording's clock.
        duration: s.
        force: N m or N.
    """

    recording: int
    dof: int
    start: float
    duration: float
    force: float


@dataclass(frozen=True)
class Variant:
    """A simulator with other numbers and other physics.

    Attributes:
        values: of the nuisances.
        effects: added physics.
        pulses: pushes from outside, in the recordings that are simulated.
    """

    values: Array
    effects: tuple[Effect, ...] = ()
    pulses: tuple[Pulse, ...] = ()


class Simulator:
    """Rollouts of a MuJoCo model of hinges and slides.

    Attributes:
        model: as it is believed to be.
        step: seconds.
        nuisances: what may be refitted.
    """

    def __init__(self, model: mujoco.MjModel, step: float | None = None, threads: int = 2) -> None:
        """With Runge-Kutta steps of `step` seconds, or with the model's own integrator and time step."""
        self.model = copy.copy(model)
        if step is not None:
            self.model.opt.timestep, self.model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
        self.model.opt.enableflags = 0
        self.step = float(self.model.opt.timestep)
        self.nuisances: tuple[Nuisance, ...] = nuisance.nuisances(model)
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self._models = ModelPool(self.model)
        self._pool = rollout.Rollout(nthread=threads)

    def compile(self, variant: Variant) -> mujoco.MjModel:
        """The model of a variant, as far as MuJoCo has its effects itself."""
        return self._changed(copy.copy(self.model), variant)

    def _changed(self, model: mujoco.MjModel, variant: Variant) -> mujoco.MjModel:
        nuisance.apply(model, self.nuisances, variant.values)
        for effect in variant.effects:
            effect.edit(model)
        mujoco.mj_setConst(model, self._data[0])
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
        out = np.empty((len(which), *windows.measured.shape))
        zero = [i for i, n in enumerate(self.nuisances) if n.kind == "zero"]
        for p, variant in enumerate(variants[i] for i in which):
            time = windows.time
            for effect in variant.effects:
                time = effect.observe(time)
            out[p] = _hermite(positions[p], velocities[p], time - windows.start[:, None], self.step)
            out[p] += variant.values[zero]
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
        copies = self._models.take(len(variants))
        models = [self._changed(model, variant) for model, variant in zip(copies, variants, strict=True)]
        commands = np.stack([self._commands(variant, windows) for variant in variants])[which]
        p, w, nv, s = len(which), len(windows), self.model.nv, windows.steps
        batch = [models[i] for i in which for _ in range(w)]
        state = np.zeros((p * w, mujoco.mj_stateSize(self.model, _STATE)))
        state[:, 1 : 1 + nv], state[:, 1 + nv : 1 + 2 * nv] = q.reshape(-1, nv), v.reshape(-1, nv)
        path = np.empty((p, w, s + 1, 2 * nv))
        path[:, :, 0] = state[:, 1 : 1 + 2 * nv].reshape(p, w, -1)
        nu = self.model.nu
        control = np.zeros((p, w, s, nu + nv))
        control[..., :nu], control[..., nu:] = commands, 0.0 if pushes is None else pushes
        if any(variant.pulses for variant in variants):
            control[..., nu:] += np.stack([self._pushes(variant, windows) for variant in variants])[which]
        forced = [i for i, variant in enumerate(which) if any(e.forces for e in variants[variant].effects)]
        free = [i for i in range(p) if i not in set(forced)]
        if free:
            rows = np.concatenate([np.arange(i * w, (i + 1) * w) for i in free])
            out = self._run([batch[i] for i in rows], state[rows], control[free].reshape(len(rows), s, -1))
            path[free, :, 1:] = out.reshape(len(free), w, s, -1)[..., 1 : 1 + 2 * nv]
        if not forced:
            return path[..., :nv], path[..., nv:], commands
        rows = np.concatenate([np.arange(i * w, (i + 1) * w) for i in forced])
        batch, state = [batch[i] for i in rows], state[rows]
        speed = np.zeros((len(forced), w, nv))
        memories = {
            (i, effect): effect.begin(models[which[row]], v[row])
            for i, row in enumerate(forced)
            for effect in variants[which[row]].effects
            if effect.forces
        }
        for k in range(s):
            now = state[:, 1 : 1 + 2 * nv].reshape(len(forced), w, -1)
            q0, v0 = now[..., :nv], now[..., nv:]
            gain = (v0 - speed) / self.step if k else np.zeros_like(v0)
            middle = q0 + 0.5 * self.step * v0 + 0.125 * self.step**2 * gain, v0 + 0.5 * self.step * gain
            speed = v0
            time = windows.start + (k + 0.5) * self.step
            for i, row in enumerate(forced):
                for effect in variants[which[row]].effects:
                    if effect.forces:
                        force, memories[i, effect] = effect.advance(
                            models[which[row]],
                            memories[i, effect],
                            time,
                            middle[0][i],
                            middle[1][i],
                            control[row, :, k, :nu],
                            self.step,
                        )
                        control[row, :, k, nu:] += force
            state = self._run(batch, state, np.ascontiguousarray(control[forced, :, k].reshape(len(rows), 1, -1)))[:, 0]
            path[forced, :, k + 1] = state[:, 1 : 1 + 2 * nv].reshape(len(forced), w, -1)
        return path[..., :nv], path[..., nv:], commands

    def _pushes(self, variant: Variant, windows: Windows) -> Array:
        """Mean forces of pulses over each step, `[W, S, nv]`."""
        out = np.zeros((len(windows), windows.steps, self.model.nv))
        edges = windows.start[:, None] + self.step * np.arange(windows.steps + 1)
        for pulse in variant.pulses:
            of = windows.recording == pulse.recording
            inside = np.clip(edges[of], pulse.start, pulse.start + pulse.duration)
            out[of, :, pulse.dof] += pulse.force * np.diff(inside, axis=1) / self.step
        return out

    def _run(self, models: list[mujoco.MjModel], state: Array, control: Array) -> Array:
        out = np.empty((*control.shape[:2], state.shape[1]))
        self._pool.rollout(models, self._data, state, control, control_spec=_CONTROL, state=out)
        return out

    def _commands(self, variant: Variant, windows: Windows) -> Array:
        """What motors get, `[W, S, nu]`."""
        filtered = list(windows.commands)
        for effect in variant.effects:
            filtered = [effect.command(self.model, u, self.step) for u in filtered]
        out = np.empty((len(windows), windows.steps, self.model.nu))
        for w, (r, k) in enumerate(zip(windows.recording, windows.first, strict=True)):
            piece = filtered[r][k : k + windows.steps]
            out[w, : len(piece)], out[w, len(piece) :] = piece, piece[-1:]
        return out


def _hermite(q: Array, v: Array, time: Array, step: float) -> Array:
    """Positions at times `[W, n]` between steps, from positions and velocities `[W, S+1, nv]`."""
    k = np.clip((time / step).astype(int), 0, q.shape[1] - 2)
    s = (time / step - k)[..., None]
    row = np.arange(len(q))[:, None]
    q0, q1, v0, v1 = q[row, k], q[row, k + 1], v[row, k] * step, v[row, k + 1] * step
    return (1 + 2 * s) * (1 - s) ** 2 * q0 + s * (1 - s) ** 2 * v0 + s**2 * (3 - 2 * s) * q1 + s**2 * (s - 1) * v1
