"""Dry friction that gives way like a brush before it slides."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, functions, parameter


@dataclass(frozen=True)
class HystereticFriction(JointEffect):
    """Bristles that bend before they slip (LuGre; Canudas de Wit et al., 1995). Memory: their deflection."""

    id: ClassVar[str] = "hysteretic_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -s*z, dz/dt = qd - s*|qd|*z/c"
    memory: ClassVar[int] = 1

    c: float = parameter("N m", 0.02, low=0.0)
    s: float = parameter("N m/rad", 0.2, low=0.1, high=500.0, grid=(1.0, 4.0, 16.0))

    def begin(self, model: mujoco.MjModel, v: Array) -> Array:
        """Slipping."""
        return self.c / self.s * np.sign(v[..., self.dof(model), None])

    def advance(
        self, model: mujoco.MjModel, memory: Array, t: Array, q: Array, v: Array, u: Array, h: float
    ) -> tuple[Array, Array]:
        """Exact for constant speed."""
        dof, out = self.dof(model), np.zeros_like(v)
        out[..., dof], bent = self.rub(memory[..., 0], v[..., dof], h)
        return out, bent[..., None]

    def rub(self, bent: Array, speed: Array, h: float) -> tuple[Array, Array]:
        """Mean torque and deflection after a step at constant speed, exact; all `[...]`."""
        xp = functions(speed)
        there = xp.asarray(self.c > 0)
        c = xp.where(there, self.c, 1.0)
        steady = c / self.s * xp.sign(speed)
        decay = xp.maximum(self.s * abs(speed) * h / c, 1e-9)
        torque = -self.s * (steady + (bent - steady) * -xp.expm1(-decay) / decay)
        return xp.where(there, torque, 0.0), xp.where(there, steady + (bent - steady) * xp.exp(-decay), bent)
