"""What torque the refitted simulator lacks, from smoothed accelerations; and an effect that is a learnt torque."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.signal import savgol_filter

from keycld_control.benchmarks.blind.baselines.common import Setup
from keycld_control.benchmarks.refitting import average_commands
from keycld_envs.effects import Effect
from keycld_envs.effects.base import Kind
from keycld_envs.recordings import Recording

Array = NDArray[np.float64]
Law = Callable[[Array, Array, Array], Array]
"""Torque `[..., nv]` of positions `[..., nv]`, velocities `[..., nv]`, and commands `[..., nu]`."""
SMOOTH = 0.15
"""Seconds of the cubic polynomials that give speeds and accelerations (Savitzky and Golay, 1964)."""


@dataclass(frozen=True)
class ResidualTorque:
    """Torque that is missing in one recording, on an even grid without its ends.

    Attributes:
        q: `[T, nv]` positions with the fitted zeros taken out.
        v: `[T, nv]` velocities.
        u: `[T, nu]` commands.
        torque: `[T, nv]` that is missing, N m or N.
    """

    q: Array
    v: Array
    u: Array
    torque: Array


def missing_torque(setup: Setup, recording: Recording) -> ResidualTorque:
    """The torque that the refitted simulator lacks to move as recorded."""
    variant = setup.refitted.point.variant
    nuisances = zip(setup.refitted.problem.nuisances, variant.values, strict=True)
    zero = np.array([value for nuisance, value in nuisances if nuisance.kind == "zero"])
    return torque_lacking(setup.simulator.compile(variant), recording, setup.spacing, zero)


def torque_lacking(
    model: mujoco.MjModel, recording: Recording, spacing: float, zero: Array | float = 0.0, smooth: float = SMOOTH
) -> ResidualTorque:
    """The torque that a simulator lacks to move as recorded, by inverse dynamics.

    Args:
        model: the simulator.
        recording: with joint positions.
        spacing: of the even grid, s.
        zero: of the encoders, rad or m.
        smooth: seconds of the polynomials.
    """
    data = mujoco.MjData(model)
    t, q = np.asarray(recording.t_state), np.asarray(recording.qpos) - zero
    grid = np.arange(t[0], t[-1], spacing)
    q = np.stack([np.interp(grid, t[np.isfinite(y)], y[np.isfinite(y)]) for y in q.T], axis=1)
    width = max(5, 2 * round(smooth / spacing / 2) + 1)
    q, v, a = (np.asarray(savgol_filter(q, width, 3, deriv=d, delta=spacing, axis=0), float) for d in range(3))
    edges = np.append(grid, grid[-1] + spacing) - 0.5 * spacing
    u, torque = average_commands(recording, edges), np.empty_like(q)
    x = np.linspace(-1, 1, width + 2)[1:-1]
    u = convolve1d(u, (1 - x**2) ** 2 / np.sum((1 - x**2) ** 2), axis=0)  # as the polynomials smooth accelerations
    for k in range(len(grid)):
        data.qpos[:], data.qvel[:], data.qacc[:], data.ctrl[:] = q[k], v[k], a[k], u[k]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        torque[k] = data.qfrc_inverse - data.qfrc_actuator
    inside = slice(width // 2, -(width // 2))
    return ResidualTorque(q[inside], v[inside], u[inside], torque[inside])


@dataclass(frozen=True, eq=False)
class LearntTorque(Effect):
    """Any function of positions, velocities and commands, `[..., nv]`, as a generalised force.

    Attributes:
        law: the function.
        fastest: `[nv]` of the motion that it was learnt from; faster counts as this.
        largest: `[nv]` torque there; more is cut off, so that a bad law cannot make rollouts infinite.
    """

    id: ClassVar[str] = "unknown"
    family: ClassVar[str] = "unknown"
    kind: ClassVar[Kind] = "world"
    equation: ClassVar[str] = "tau = f(q, v, u)"

    law: Law
    fastest: Array
    largest: Array

    @classmethod
    def of(cls, law: Law, runs: Sequence[ResidualTorque]) -> Self:
        """A law with the limits of the motion that it was learnt from."""
        fastest, largest = (
            np.max([np.abs(z).max(axis=0) for z in (getattr(r, key) for r in runs)], axis=0) for key in ("v", "torque")
        )
        return cls("world", law, fastest, largest)

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple[Self, ...]:
        """No candidates: the law is learnt, not searched for."""
        return ()

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """The law, within its limits."""
        return np.clip(self.law(q, np.clip(v, -self.fastest, self.fastest), u), -self.largest, self.largest)
