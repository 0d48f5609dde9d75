"""Dry friction that gives way like a brush before it slides."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, JointEffect, parameter


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
        if self.c <= 0:
            return out, memory
        speed = v[..., dof]
        steady = self.c / self.s * np.sign(speed)
        decay = np.maximum(self.s * np.abs(speed) * h / self.c, 1e-9)
        z = steady + (memory[..., 0] - steady) * np.exp(-decay)
        out[..., dof] = -self.s * (steady + (memory[..., 0] - steady) * -np.expm1(-decay) / decay)
        return out, z[..., None]
