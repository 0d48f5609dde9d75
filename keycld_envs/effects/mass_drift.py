"""A link that loses mass while it is recorded."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import EVERY, Array, Effect, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import flat


@dataclass(frozen=True)
class MassDrift(Effect):
    """The mass of a body changes linearly in time: something leaks, or builds up."""

    id: ClassVar[str] = "parameter_drift"
    family: ClassVar[str] = "time-varying"
    kind: ClassVar = "body"
    program: ClassVar[str | None] = EVERY
    equation: ClassVar[str] = "m(t) = m*(1 + r*t)"

    r: float = parameter("1/s", 0.01, low=-0.2, high=0.5)

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple["MassDrift", ...]:
        """Every body that moves in joints of its own."""
        return tuple(cls(model.body(b).name) for b in range(1, model.nbody) if model.body_dofnum[b])

    def mass_factor(self, t: Array) -> Array:
        """Factor of the mass at times."""
        return functions(t).maximum(0.05, 1 + self.r * t)

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """What gives the model the acceleration that it would have with the other mass."""
        if self.r == 0:
            return np.zeros_like(v)
        body, data = model.body(self.where).id, mujoco.MjData(model)
        mass, inertia = float(model.body_mass[body]), model.body_inertia[body].copy()
        states = [flat(x) for x in (q, v, u)]
        out = np.zeros((len(states[0]), model.nv))
        times = np.broadcast_to(t, v.shape[:-1]).ravel()
        for row, time, position, velocity, command in zip(out, times, *states, strict=True):
            data.qpos[:], data.qvel[:], data.ctrl[:] = position, velocity, command
            factor = self.mass_factor(np.asarray(time))
            model.body_mass[body], model.body_inertia[body] = factor * mass, factor * inertia
            mujoco.mj_forward(model, data)
            acceleration = data.qacc.copy()
            model.body_mass[body], model.body_inertia[body] = mass, inertia
            mujoco.mj_forward(model, data)
            mujoco.mj_mulM(model, data, row, acceleration - data.qacc)
        return out.reshape(v.shape)
