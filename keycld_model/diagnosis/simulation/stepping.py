"""Who steps a batch of rollouts: an engine all at once, or step by step where effects push that no engine has."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.rigid_body.effects import AppliedEffects
from keycld_model.rigid_body.engine import Copies, Engine

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """P rollouts of W windows, S steps each.

    Attributes:
        models: of V variants.
        pushing: effects of each variant that push.
        which: `[P]` variant of each rollout of all windows.
        windows: W windows.
        start: `[P, W, 2 nv]` positions and velocities at first.
        control: `[P, W, S, nu + nv]` commands, and forces from outside, held over each step.
        motors: `[P, W, size]` states of MuJoCo to begin with, if motors remember.
    """

    models: Sequence[mujoco.MjModel]
    pushing: Sequence[AppliedEffects]
    which: NDArray[np.int64]
    windows: Windows
    start: Array
    control: Array
    motors: Array | None

    def take(self, rows: NDArray[np.int64]) -> "Batch":
        """Some of the rollouts."""
        motors = None if self.motors is None else self.motors[rows]
        return replace(self, which=self.which[rows], start=self.start[rows], control=self.control[rows], motors=motors)

    def states(self, by: Engine) -> Array:
        """States `[P * W, size]` of an engine to begin with."""
        number = self.start.shape[0] * self.start.shape[1]
        state = np.zeros((number, by.size)) if self.motors is None else self.motors.reshape(number, by.size).copy()
        state[:, by.motion] = self.start.reshape(number, -1)
        return state

    def copies(self, pushing: Sequence[AppliedEffects]) -> Copies:
        """For an engine, with some of the effects."""
        windows = len(self.windows)
        return Copies(
            self.models, pushing, np.repeat(self.which, windows), np.tile(np.arange(windows), len(self.which))
        )


def at_once(by: Engine, batch: Batch) -> Array:
    """Positions and velocities after every step, `[P, W, S, 2 nv]`, by an engine that has all effects."""
    p, w, s, _ = batch.control.shape
    used = set(batch.which.tolist())
    present = [effects if i in used else AppliedEffects() for i, effects in enumerate(batch.pushing)]
    flat, clock = batch.control.reshape(p * w, s, -1), np.tile(batch.windows.begun, p)
    path = by.run(by.batch(batch.copies(present)), batch.states(by), flat, clock)
    return path[..., by.motion].reshape(p, w, s, -1)


def step_by_step(by: Engine, batch: Batch) -> Array:
    """Positions and velocities after every step, `[P, W, S, 2 nv]`; each force is held at its value in the middle."""
    models, which, h = batch.models, batch.which, batch.windows.step
    p, w, s, _ = batch.control.shape
    nv, nu = models[0].nv, models[0].nu
    state, out = batch.states(by), np.empty((p, w, s, 2 * nv))
    copies = by.batch(batch.copies([AppliedEffects()] * len(models)))
    rows = {i: np.flatnonzero(which == i) for i in np.unique(which)}
    acting = [(i, effect) for i in rows for effect in batch.pushing[i].effects]
    memories = [np.repeat(m[None], len(rows[i]), axis=0) for i in rows for m in batch.pushing[i].memories]
    clock, time = np.tile(batch.windows.begun, p), batch.windows.begun + h / 2
    before = batch.start[..., nv:]
    for k in range(s):
        now = state[:, by.motion].reshape(p, w, -1)
        q, v = now[..., :nv], now[..., nv:]
        gain = (v - before) / h
        middle_q, middle_v, before = q + 0.5 * h * v + 0.125 * h**2 * gain, v + 0.5 * h * gain, v.copy()
        here = batch.control[:, :, k].copy()
        for m, (i, effect) in enumerate(acting):
            r = rows[i]
            then = np.broadcast_to(time + k * h, (len(r), w))
            motion = middle_q[r], middle_v[r]
            force, memories[m] = effect.advance(models[i], memories[m], then, *motion, here[r, :, :nu], h)
            here[r, :, nu:] += force
        state = by.run(copies, state, here.reshape(p * w, 1, -1), clock)[:, 0]
        out[:, :, k] = state[:, by.motion].reshape(p, w, -1)
    return out
