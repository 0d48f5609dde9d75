"""The motion that recordings show, and the forces that a simulator would need for it.

In each window, initial states and forces at the joints, constant over parts of the window, are fitted until the
simulator moves as was measured (input estimation). Everything that a simulator may lack is linear along that motion: in
inertias, in coefficients of friction, in what motors do. No measured signal is differentiated.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects.functions import smooth_sign
from keycld_envs.recordings import Recording
from keycld_model.delan.rig import LearnedDynamics, common_factor, deviation, learned_dynamics, own_inertias
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.prepare import accurate_step, ready, spacing, thin
from keycld_model.diagnosis.inputs.windows import Windows, cut
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant

Array = NDArray[np.float64]
FEWEST, MOST = 12, 40
"""Samples of a window."""
FINER = 5
"""Parts of each time for which an unknown force is constant, in which forces are averaged."""
FINEST = 2e-4
"""Positions are followed no closer than this, rad or m: steps of the integrator are no better."""
STANDS_OUT = 2.0
"""Standard deviations by which the mean square of differences must exceed that of noise, to be a vibration."""
FAST = 60.0
"""Acceleration that unknown forces may well make, rad/s² or m/s²."""
RESTING = 0.05
"""Speed below which a joint may rest, rad/s or m/s."""


def resting(v: Array) -> Array:
    """Share to which joints may rest at velocities, where dry friction may be any force up to its own."""
    return 1 - np.tanh(np.abs(v) / RESTING) ** 2


@dataclass(frozen=True)
class Motion:
    """W windows of a motion with nv joints, S steps and B parts each.

    Attributes:
        problem: windows and simulator, without dry friction, which would stop it where forces are looked for.
        noise: `[nv]` standard deviation of the sensors, rad or m.
        q: `[W, S, nv]` positions in the middle of the steps.
        v: `[W, S, nv]` velocities.
        a: `[W, S, nv]` accelerations.
        u: `[W, S, nu]` commands.
        time: `[W, S]` s from the start of the recording.
        path: `[W, S + 1, nv]` positions and velocities at the steps.
        required: `[W, S, nv]` generalised forces of the motion by inverse dynamics.
        states: `[W, r, 2 nv]` minus the derivative of whitened residuals to initial states.
        response: `[W, r, nv, B]` the same to forces at joints.
        residual: `[W, r]` whitened residuals without the forces, to first order.
        forces: `[W, B, nv]` unknown forces with which the simulator follows the recordings, N m or N.
    """

    problem: Problem
    noise: Array
    q: Array
    v: Array
    a: Array
    u: Array
    time: Array
    path: tuple[Array, Array]
    required: Array
    states: Array
    response: Array
    residual: Array
    forces: Array

    @classmethod
    def of(cls, recordings: Sequence[Recording], model: mujoco.MjModel, criteria: Criteria) -> "Motion":
        """The motion of recordings that suit the model, all sampled as rarely as the slowest."""
        recordings = ready(recordings, model, 1)
        slowest = max(spacing([recording]) for recording in recordings)
        recordings = [thin(recording, slowest) for recording in recordings]
        bare = copy.copy(model)
        bare.dof_frictionloss[:] = 0.0
        samples = int(np.clip(round(criteria.sizes.window_beside_forces / spacing(recordings)), FEWEST, MOST))
        noise = JointPositions(bare).calibrated(recordings).noise
        observation = JointPositions(bare, np.maximum(noise, FINEST))
        simulator = Simulator(bare, accurate_step(recordings), criteria=criteria)
        problem = Problem(simulator, cut(recordings, observation, simulator.step, samples))
        pinned = _Pinned.of(problem)
        problem = pinned.problem
        (q, v, u), h = pinned.roll(), simulator.step
        middle_v = 1.5 * np.diff(q, axis=1) / h - (v[:, 1:] + v[:, :-1]) / 4
        middle_q = (q[:, 1:] + q[:, :-1]) / 2 - h / 8 * np.diff(v, axis=1)
        a, windows = np.diff(v, axis=1) / h, problem.windows
        pinned.divide(FINER)
        residual, states, response = pinned.linearised()
        out = cls(
            problem,
            noise,
            middle_q,
            middle_v,
            a,
            u,
            windows.begun[:, None] + (np.arange(windows.steps) + 0.5) * h,
            (q, v),
            inverse_dynamics(bare, middle_q, middle_v, a),
            states,
            response,
            residual + np.einsum("wrjb,wbj->wr", response, pinned.forces),
            pinned.forces,
        )
        learned = learned_dynamics(model)
        return out if learned is None else out._beside(_learned_dry_friction(learned, model, middle_v))

    @property
    def model(self) -> mujoco.MjModel:
        """The simulator."""
        return self.problem.simulator.model

    @property
    def windows(self) -> Windows:
        """Of the recordings."""
        return self.problem.windows

    @property
    def moves(self) -> NDArray[np.bool_]:
        """`[W]` windows in which some joint is not held still."""
        return np.any(self.travel >= self.problem.criteria.moves * np.percentile(self.travel, 90, axis=0), axis=1)

    @property
    def travel(self) -> Array:
        """`[W, nv]` how far joints move, rad or m."""
        return np.ptp(self.q, axis=1)

    @property
    def misfit(self) -> Array:
        """Mean square of whitened residuals of each window, with the forces, `[W]`."""
        return np.mean(self._left**2, axis=1)

    @property
    def ringing(self) -> Array:
        """Mean square of whitened residuals of each window and joint, with the forces, `[W, nv]`."""
        return np.mean(self._left.reshape(len(self.windows), -1, len(self.noise)) ** 2, axis=1)

    @cached_property
    def vibrating(self) -> Array:
        """Velocities with what encoders show beside the path, `[W, S, nv]`: friction answers to vibrations, too.

        Differences of what is left of neighbouring samples, drawn towards none by the share that may be noise: its
        variance over so few samples, and `STANDS_OUT` standard deviations of that.
        """
        windows, out = self.windows, self.v.copy()
        shown = self._left.reshape(len(windows), windows.samples, -1) * self.problem.noise
        shown = np.where(np.isfinite(windows.measured), shown, np.nan)
        since = windows.time - windows.start[:, None]
        steps = np.diff(since, axis=1)[..., None]
        rate, middle = np.diff(shown, axis=1) / steps, (since[:, 1:] + since[:, :-1]) / 2
        noise = np.nanmean(np.where(np.isnan(rate), np.nan, 2 * (self.noise / steps) ** 2), axis=1)
        noise *= 1 + STANDS_OUT * np.sqrt(2 / np.maximum(np.isfinite(rate).sum(axis=1), 1))
        signal = np.clip(1 - noise / np.maximum(np.nanmean(rate**2, axis=1), 1e-300), 0.0, 1.0)
        times = (np.arange(windows.steps) + 0.5) * windows.step
        for w, j in np.ndindex(signal.shape):
            there = np.isfinite(rate[w, :, j])
            if there.any():
                out[w, :, j] += signal[w, j] * np.interp(times, middle[w, there], rate[w, there, j])
        return out

    @property
    def _left(self) -> Array:
        return self.residual - np.einsum("wrjb,wbj->wr", self.response, self.forces)

    @property
    def usual_force(self) -> Array:
        """Root mean square of the forces in each window, `[W, nv]`, N m or N."""
        return np.sqrt(np.mean(self.forces**2, axis=1))

    def _beside(self, known: Array) -> "Motion":
        """With forces `[W, S, nv]` that are known beside those that are not."""
        residual, forces = self.residual - self.answer(known), self.forces - self.over_parts(known)
        return replace(self, residual=residual, forces=forces)

    def take(self, rows: NDArray[np.int64]) -> "Motion":
        """Some of the windows."""
        arrays = {name: getattr(self, name)[rows] for name in _PER_WINDOW}
        path = self.path[0][rows], self.path[1][rows]
        return replace(self, problem=self.problem.take(rows), path=path, **arrays)

    def over_parts(self, values: Array) -> Array:
        """Means of values `[W, S, nv]` over the parts of the windows, `[W, B, nv]`."""
        edges = self.windows.edges(self.response.shape[-1])
        return np.add.reduceat(np.nan_to_num(values), edges[:-1], axis=1) / np.diff(edges)[:, None]

    def answer(self, forces: Array) -> Array:
        """Fall of whitened residuals `[W, r]` with forces `[W, S, nv]`."""
        return np.einsum("wrjb,wbj->wr", self.response, self.over_parts(forces), optimize=True)

    def answer_by_step(self, forces: Array) -> Array:
        """The same without averages over the parts of windows, for forces that may change in every step.

        Commands of a feedback are as noisy as what it is fed. That averages out in the motion, but not in what another
        delay would have done to each of them.
        """
        most = np.max(np.abs(forces) / (0.01 * FAST * np.maximum(self.model.dof_M0, 1e-9)), initial=0.0)
        if not most > 0:
            return np.zeros_like(self.residual)
        steady = np.repeat(self.forces, np.diff(self.windows.edges(self.forces.shape[1])), axis=1)
        here, there = (self._rolled(pushes) for pushes in (steady, steady + forces / most))
        return np.nan_to_num(most * (here - there))

    def _rolled(self, pushes: Array) -> Array:
        """Whitened residuals `[W, r]` of rollouts with pushes `[W, S, nv]`."""
        none, one = Variant(np.zeros(len(self.problem.nuisances))), np.zeros(1, np.int64)
        q, v = (x[:, 0][None] for x in self.path)
        return self.problem.whiten(self.problem.predict([none], one, q, v, pushes[None]))[0]


_PER_WINDOW = ("q", "v", "a", "u", "time", "required", "states", "response", "residual", "forces")


def _learned_dry_friction(learned: LearnedDynamics, model: mujoco.MjModel, v: Array) -> Array:
    """Of a joint model, at velocities `[W, S, nv]`; what an ordinary simulator has is found anew."""
    with jax.enable_x64(True):
        fading = np.asarray(learned.fading_friction(jnp.asarray(v.reshape(-1, v.shape[-1]).T))).T
    most = model.dof_frictionloss + (fading.reshape(v.shape) if fading.ndim else fading)
    return -most * smooth_sign(v) * (1 - resting(v))


def inverse_dynamics(model: mujoco.MjModel, q: Array, v: Array, a: Array) -> Array:
    """Generalised forces `[..., nv]` that a motion needs, without constraints.

    In the rig of a joint model, the inertia of its bodies gives way to what was learned.
    """
    data, free = mujoco.MjData(model), copy.copy(model)
    free.opt.disableflags = int(free.opt.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    out = np.empty_like(v)
    for at in np.ndindex(v.shape[:-1]):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[at], v[at], a[at]
        mujoco.mj_inverse(free, data)
        out[at] = data.qfrc_inverse
    if (learned := learned_dynamics(model)) is not None:
        out += learned.forces(q, v, a, common_factor(model), deviation(model)) - own_inertias(model) * a
    return out


@dataclass
class _Pinned:
    """Initial states and forces that are being fitted.

    Attributes:
        problem: windows and simulator.
        q: `[W, nv]` initial positions.
        v: `[W, nv]` initial velocities.
        forces: `[W, B, nv]`.
        spread: `[nv]` standard deviation expected of forces: wide, so that the motion is followed.
    """

    problem: Problem
    q: Array
    v: Array
    forces: Array
    spread: Array

    @classmethod
    def of(cls, problem: Problem) -> "_Pinned":
        """Fitted by damped Gauss-Newton steps, each window with a damping of its own."""
        windows, model = problem.windows, problem.simulator.model
        q, v = windows.initial_states()
        parts = max(1, round(windows.steps * windows.step / problem.criteria.sizes.constant_force))
        out = cls(problem, q, v, np.zeros((len(q), parts, model.nv)), FAST * np.maximum(model.dof_M0, 1e-9))
        damping = np.full(len(q), 1e-6)
        for _ in range(8):
            gained, damping = out._step(damping)
            if gained < 1.0:  # nats, in any window
                break
        return out._finite()

    def _finite(self) -> "_Pinned":
        """Without windows in which numbers run away."""
        here = self._residual(self.q[None], self.v[None], self.forces[None])[0]
        rows = np.flatnonzero(np.isfinite(self._cost(here, self.forces)))
        if len(rows) == len(self.q):
            return self
        return replace(self, problem=self.problem.take(rows), q=self.q[rows], v=self.v[rows], forces=self.forces[rows])

    def divide(self, times: int) -> None:
        """Divide each part of the windows, with the same forces."""
        steps = self.problem.windows.steps
        times = max(1, min(times, steps // self.forces.shape[1]))
        self.forces = np.repeat(self.forces, times, axis=1)

    def _pushes(self, forces: Array) -> Array:
        return np.repeat(forces, np.diff(self.problem.windows.edges(forces.shape[1])), axis=1)

    def _residual(self, q: Array, v: Array, forces: Array) -> Array:
        """Whitened residuals `[..., W, r]`, for arguments with the same leading shape."""
        pushes = np.stack([self._pushes(f) for f in forces])
        none = Variant(np.zeros(len(self.problem.nuisances)))
        return self.problem.whiten(self.problem.predict([none], np.zeros(len(q), int), q, v, pushes))

    def roll(self) -> tuple[Array, Array, Array]:
        """Positions and velocities `[W, S + 1, nv]`, commands `[W, S, nu]`."""
        none = Variant(np.zeros(len(self.problem.nuisances)))
        one = np.zeros(1, np.int64)
        pushes = self._pushes(self.forces)[None]
        q, v, u = self.problem.simulator.roll(
            [none], one, self.problem.windows, self.q[None], self.v[None], pushes=pushes
        )
        return q[0], v[0], u[0]

    def linearised(self) -> tuple[Array, Array, Array]:
        """Residuals `[W, r]`, and how they fall with initial states `[W, r, 2 nv]` and forces `[W, r, nv, B]`."""
        (w, nv), parts = self.q.shape, self.forces.shape[1]
        sizes = np.concatenate([np.full(nv, 1e-4), np.full(nv, 1e-3), np.repeat(0.01 * self.spread, parts)])
        q, v, f = (np.repeat(x[None], 1 + len(sizes), axis=0) for x in (self.q, self.v, self.forces))
        for j in range(nv):
            q[1 + j, :, j] += sizes[j]
            v[1 + nv + j, :, j] += sizes[nv + j]
            for b in range(parts):
                f[1 + 2 * nv + j * parts + b, :, b, j] += sizes[2 * nv + j * parts]
        here, *there = self._residual(q, v, f)
        slopes = np.moveaxis((here - np.stack(there)) / sizes[:, None, None], 0, -1)
        return here, slopes[..., : 2 * nv], slopes[..., 2 * nv :].reshape(w, -1, nv, parts)

    def _step(self, damping: Array) -> tuple[float, Array]:
        """Nats gained in the window that gained most, and the damping after it."""
        nv = self.q.shape[1]
        here, states, response = self.linearised()
        before = self._cost(here, self.forces)
        slopes = np.concatenate([states, response.reshape(*here.shape, -1)], axis=-1)
        prior = np.concatenate([np.zeros(2 * nv), np.repeat(self.spread**-2, self.forces.shape[1])])
        flat = np.moveaxis(self.forces, 1, 2).reshape(len(self.q), -1)
        normal = np.swapaxes(slopes, 1, 2) @ slopes + np.diag(prior)
        right = np.einsum("wri,wr->wi", slopes, here)
        right[:, 2 * nv :] -= prior[2 * nv :] * flat
        normal += (damping[:, None] * np.einsum("wii->wi", normal))[..., None] * np.eye(len(prior))
        move = np.linalg.solve(normal, right[..., None])[..., 0]
        q, v = self.q + move[:, :nv], self.v + move[:, nv : 2 * nv]
        forces = self.forces + np.moveaxis(move[:, 2 * nv :].reshape(len(q), nv, -1), 1, 2)
        after = self._cost(self._residual(q[None], v[None], forces[None])[0], forces)
        better = after < before
        self.q, self.v = np.where(better[:, None], q, self.q), np.where(better[:, None], v, self.v)
        self.forces = np.where(better[:, None, None], forces, self.forces)
        gained = float(np.max(before - np.minimum(after, before)))
        return gained if better.all() else np.inf, np.where(better, damping / 5, np.maximum(damping, 1e-5) * 30)

    def _cost(self, residual: Array, forces: Array) -> Array:
        """Nats of each window, `[W]`."""
        return 0.5 * np.sum(residual**2, axis=1) + 0.5 * np.sum((forces / self.spread) ** 2, axis=(1, 2))
