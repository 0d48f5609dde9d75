"""Many short rollouts of variants of a MuJoCo model at once."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.constants import update_constants
from keycld_model.delan.rig import learned_dynamics
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.hidden_states import MotorStates, effects_that_push
from keycld_model.diagnosis.simulation.inertia import apply, inertial_nuisances
from keycld_model.diagnosis.simulation.model_pool import ModelPool
from keycld_model.diagnosis.simulation.sampling import delayed_commands, interpolated, observed_times, pulse_forces
from keycld_model.diagnosis.simulation.stepping import Batch, at_once, step_by_step
from keycld_model.diagnosis.simulation.variant import Variant
from keycld_model.rigid_body.compiled import CompiledEngine
from keycld_model.rigid_body.engine import Engine, MujocoEngine

Array = NDArray[np.float64]


class Simulator:
    """Rollouts of a MuJoCo model of hinges and slides, or of the rig of a joint model.

    Attributes:
        model: as it is believed to be.
        step: of the integrator, s.
        own_integrator: it is the model's, with the model's time step.
        nuisances: masses and lengths that may be refitted.
        criteria: how far off masses and lengths may be.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        step: float | None = None,
        threads: int = 2,
        compiled: bool = True,
        criteria: Criteria = STANDARD,
    ) -> None:
        """With Runge-Kutta steps of `step` seconds, or with the model's own integrator and time step."""
        self.model, self.own_integrator, self.criteria = copy.copy(model), step is None, criteria
        if step is not None:
            self.model.opt.timestep, self.model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
        self.model.opt.enableflags = 0
        self.step = float(self.model.opt.timestep)
        self.nuisances = inertial_nuisances(model, criteria)
        self._data = mujoco.MjData(self.model)
        self._models = ModelPool(self.model)
        self._threads, self._mujoco = threads, MujocoEngine(self.model, threads)
        self._motors = MotorStates(self.model, self._mujoco.size)
        compiled = compiled or learned_dynamics(model) is not None  # of which MuJoCo knows nothing
        self._fast = CompiledEngine.of(self.model, exact_stiction=not self.own_integrator) if compiled else None

    def with_step(self, step: float, compiled: bool = True) -> "Simulator":
        """The same with Runge-Kutta steps of another length, s."""
        return Simulator(self.model, step, self._threads, compiled, self.criteria)

    def compile(self, variant: Variant) -> mujoco.MjModel:
        """The model of a variant, as far as MuJoCo has its effects itself."""
        return self._changed(copy.copy(self.model), variant)

    def _changed(self, model: mujoco.MjModel, variant: Variant) -> mujoco.MjModel:
        apply(model, self.nuisances, variant.values[: len(self.nuisances)])
        for effect in variant.effects:
            effect.edit(model)
        update_constants(model, self._data)
        return model

    def at_samples(
        self,
        variants: Sequence[Variant],
        which: NDArray[np.int64],
        windows: Windows,
        q: Array,
        v: Array,
        pushes: Array | None = None,
    ) -> tuple[Array, Array]:
        """Joint positions and velocities that a sensor is shown, with its latency.

        Args:
            variants: V of them.
            which: `[P]` variant of each rollout of all windows.
            windows: W windows.
            q: `[P, W, nv]` positions at their starts.
            v: `[P, W, nv]` velocities.
            pushes: `[P, W, S, nv]` generalised forces from outside, held over each step.

        Returns:
            Positions and velocities, both `[P, W, n, nv]`; NaN where a rollout diverges.
        """
        together = 32  # rollouts: each may need a copy of the model, and copies are large
        if len(which) > together:
            parts = [slice(i, i + together) for i in range(0, len(which), together)]
            found = [
                self.at_samples(variants, which[p], windows, q[p], v[p], None if pushes is None else pushes[p])
                for p in parts
            ]
            positions, velocities = zip(*found, strict=True)
            return np.concatenate(positions), np.concatenate(velocities)
        used, which = np.unique(which, return_inverse=True)
        variants = [variants[i] for i in used]
        positions, velocities, _ = self.roll(variants, which, windows, q, v, pushes)
        begun = windows.begun[:, None]
        since = windows.time - windows.start[:, None] + begun
        shown = [observed_times(variant, since) - observed_times(variant, begun) for variant in variants]
        flat_q, flat_v, time = (z.reshape(-1, *z.shape[2:]) for z in (positions, velocities, np.stack(shown)[which]))
        at, speed = interpolated(flat_q, flat_v, time, self.step)
        shape = positions.shape[:2] + at.shape[1:]
        return at.reshape(shape), speed.reshape(shape)

    def roll(
        self,
        variants: Sequence[Variant],
        which: NDArray[np.int64],
        windows: Windows,
        q: Array,
        v: Array,
        pushes: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Positions and velocities `[P, W, S+1, nv]` at the steps, and commands that arrive, `[P, W, S, nu]`.

        See `at_samples` for the arguments.
        """
        models = [
            self._changed(model, variant)
            for model, variant in zip(self._models.take(len(variants)), variants, strict=True)
        ]
        filtered = [self._filtered(variant, windows) for variant in variants]
        late = [(observed_times(variant, windows.begun) - windows.begun) / self.step for variant in variants]
        commands = np.stack([delayed_commands(*some, windows) for some in zip(filtered, late, strict=True)])[which]
        forces = np.zeros((*commands.shape[:-1], self.model.nv)) if pushes is None else pushes
        if any(variant.pulses for variant in variants):
            forces = forces + np.stack([pulse_forces(variant, windows, self.model.nv) for variant in variants])[which]
        rollouts = Batch(
            models,
            effects_that_push(self.model, variants, models, filtered, windows),
            which,
            windows,
            np.concatenate([q, v], axis=-1),
            np.concatenate([commands, forces], axis=-1),
            np.stack([self._motors.at(windows, own) for own in filtered])[which] if self._motors.needed else None,
        )
        path = np.concatenate([rollouts.start[:, :, None], self._after(self._fast or self._mujoco, rollouts)], axis=2)
        if self._fast and len(stopped := np.flatnonzero(self._beyond(path).any(axis=1))):
            path[stopped, :, 1:] = self._after(self._mujoco, rollouts.take(stopped))
        nv = self.model.nv
        return path[..., :nv], path[..., nv:], commands

    def _after(self, by: Engine, batch: Batch) -> Array:
        """Positions and velocities after every step, `[P, W, S, 2 nv]`; some effects are in no program."""
        outside = [any(by is self._mujoco or e.program is None for e in some.effects) for some in batch.pushing]
        stepped = np.array(outside)[batch.which]
        if not stepped.any():
            return at_once(by, batch)
        out = np.empty((*batch.control.shape[:3], batch.start.shape[2]))
        for rows, march in ((np.flatnonzero(stepped), step_by_step), (np.flatnonzero(~stepped), at_once)):
            if len(rows):
                out[rows] = march(by, batch.take(rows))
        return out

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

    def _filtered(self, variant: Variant, windows: Windows) -> list[Array]:
        """What motors get, per recording, `[N, nu]`."""
        filtered = list(windows.commands)
        for effect in variant.effects:
            filtered = [effect.command(self.model, u, self.step) for u in filtered]
        return filtered


def usual_forces(model: mujoco.MjModel) -> Array:
    """Small but noticeable forces on the joints, N m or N, `[nv]`."""
    return 0.2 * model.dof_M0
