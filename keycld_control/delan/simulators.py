"""Simulators as models of joints: identified by mujoco.sysid, or corrected by the diagnosis."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.real.rivals import sysid
from keycld_control.benchmarks.refitting import inverse_dynamics
from keycld_envs.effects import Effect, edited
from keycld_envs.effects.edited import resistance, torque_per_command
from keycld_envs.effects.places import ActuatorEffect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import diagnose

Floats = NDArray[np.float64]
SUBSTEP = 2e-3
"""Of rollouts, s, at most; semi-implicit steps."""
TRIED = 4001
"""Torques on the curve of a motor on which its command is looked up."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulator with effects, every joint of which has a motor.

    Attributes:
        model: without the effects.
        effects: of joints and motors.
        offset: `[n]` what encoders show where a joint is at zero, rad or m.
    """

    model: mujoco.MjModel
    effects: tuple[Effect, ...] = ()
    offset: Floats | float = 0.0

    @cached_property
    def _after(self) -> mujoco.MjModel:
        return edited(self.model, self.effects)

    @cached_property
    def _moving(self) -> mujoco.MjModel:
        """With the inertias of the effects; what resists is counted by itself."""
        out = edited(self.model, self.effects)
        for name in ("dof_damping", "dof_dampingpoly", "dof_frictionloss"):
            getattr(out, name)[:] = 0.0
        return out

    def inverse_dynamics(self, q: Floats, v: Floats, a: Floats) -> Floats:
        """Torques that are commanded `[T, n]` for a motion; delays and lags do not count."""
        q = q - self.offset
        needed = inverse_dynamics(self._moving, q, v, a) - self._given(q, v)
        return np.stack([self._command(i, needed[:, i]) for i in range(needed.shape[1])], axis=1)

    def rollout(
        self, q: Floats, v: Floats, tau: Floats, timestep: float, hold: Literal["held", "linear"] = "linear"
    ) -> tuple[Floats, Floats]:
        """Positions and velocities `[T, n]` from a state, under torques `[T, n]`; see `JointModel.rollout`."""
        parts = max(1, int(np.ceil(timestep / SUBSTEP)))
        h = timestep / parts
        fine = np.interp(np.arange((len(tau) - 1) * parts) + 0.5, np.arange(len(tau)) * parts, np.arange(len(tau)))
        rows = np.floor(fine).astype(int) if hold == "held" else fine
        told = np.stack([np.interp(rows, np.arange(len(tau)), column) for column in tau.T], axis=1)
        torque, data = self._torques(told, h), mujoco.MjData(self._moving)
        data.qpos[:], data.qvel[:] = q - self.offset, v
        out = [(q, v)]
        for k, now in enumerate(torque, 1):
            here, speed = data.qpos.copy(), data.qvel.copy()
            data.qfrc_applied[:] = now + self._given(here, speed)
            mujoco.mj_forward(self._moving, data)
            step = data.qvel + h * data.qacc
            stops = np.sign(step) != np.sign(speed)
            data.qvel[:] = np.where(stops & (np.abs(step) < h * self._holds), 0.0, step)
            data.qpos[:] += h * data.qvel
            if k % parts == 0:
                out.append((data.qpos + self.offset, data.qvel.copy()))
        positions, velocities = map(np.array, zip(*out, strict=True))
        return positions, velocities

    @cached_property
    def _holds(self) -> Floats:
        """Decelerations by dry friction, which ends at rest, rad/s^2 or m/s^2."""
        return self._after.dof_frictionloss / np.maximum(self._after.dof_M0, 1e-9)

    def _given(self, q: Floats, v: Floats) -> Floats:
        """Forces of everything but weight, inertia and motors, `[..., n]`."""
        out = resistance(self._moving, self._after, v)
        for effect in self.effects:
            if not (isinstance(effect, ActuatorEffect) or effect.observes or effect.memory):
                none = np.zeros((*q.shape[:-1], self.model.nu))
                out = out + effect.force(self.model, none[..., 0], q, v, none)
        return out

    def _torques(self, told: Floats, h: float) -> Floats:
        """Of the motors `[T, n]`, for torques that are commanded."""
        per_command = torque_per_command(self.model)
        u = told @ np.linalg.pinv(per_command).T
        for effect in self.effects:
            if isinstance(effect, ActuatorEffect):
                u = effect.command(self.model, u, h)
        return u @ per_command.T

    def _command(self, joint: int, torque: Floats) -> Floats:
        """Torques that are told a motor that gives others, `[T]`, on its curve."""
        at_once = [e for e in self.effects if isinstance(e, ActuatorEffect) and not e.memory and not _late(e)]
        if not at_once:
            return torque
        most = 3 * float(np.abs(torque).max()) + 1e-9
        tried = np.zeros((TRIED, self.model.nv))
        tried[:, joint] = np.linspace(-most, most, TRIED)
        given = Simulated(self.model, tuple(at_once))._torques(tried, 1.0)[:, joint]
        return np.interp(torque, np.maximum.accumulate(given), tried[:, joint])


def _late(effect: ActuatorEffect) -> bool:
    """Whether a motor answers later."""
    return effect.id in ("actuator_delay", "actuator_lag")


def corrected(recordings: Sequence[Recording], model: mujoco.MjModel) -> Simulated:
    """What the diagnosis of recordings makes of a simulator."""
    report = diagnose(recordings, model)
    zeros = {name: number.value for name, number in report.nuisance.items()}
    offset = [zeros.get(f"zero of {model.joint(j).name}", 0.0) for j in range(model.njnt)]
    found = report.evidence
    return (
        Simulated(model, (), np.array(offset))
        if found is None
        else Simulated(found.refitted, found.effects, np.array(offset))
    )


def identified(recordings: Sequence[Recording], model: mujoco.MjModel) -> Simulated:
    """What mujoco.sysid makes of it.

    Raises:
        MissingPackage: if the extra `sysid` is not installed.
    """
    return Simulated(*sysid.simulator_of(recordings, model))


METHODS: Mapping[str, Callable[[Sequence[Recording], mujoco.MjModel], Simulated]] = {
    "sysid": identified,
    "corrected": corrected,
}
"""By name."""
