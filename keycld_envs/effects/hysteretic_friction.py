"""Dry friction that gives way like a brush before it slides."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Confusable, Seen, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import JointEffect
from keycld_envs.effects.stribeck_friction import FADING


@dataclass(frozen=True)
class HystereticFriction(JointEffect):
    """Bristles that bend before they slip (LuGre; Canudas de Wit et al., 1995). Memory: their deflection.

    They slip at c, of more the slower: c + extra at rest. Friction that grows with speed is viscous friction.
    """

    id: ClassVar[str] = "hysteretic_friction"
    family: ClassVar[str] = "dissipation"
    equation: ClassVar[str] = "tau = -(s*z + d*dz/dt), dz/dt = qd - s*|qd|*z/(c + extra*exp(-(qd/vs)^2))"
    confusable: ClassVar[Confusable | None] = Confusable("dry friction", {"c": 1.0})
    memory: ClassVar[int] = 1
    memory_spread: ClassVar[tuple[float, ...]] = (0.03,)

    c: float = parameter("N m", 0.02, low=0.0)
    extra: float = parameter("N m", 0.02, low=0.0)
    d: float = parameter("N m s/rad", 0.02, low=0.0)
    s: float = parameter("N m/rad", 0.2, low=0.02, high=500.0, grid=(0.3, 1.0, 4.0, 16.0))
    vs: float = parameter("rad/s", 0.1, low=0.02, high=5.0, grid=(0.3, 1.0))

    def grids(self, model: mujoco.MjModel, seen: Seen) -> dict[str, tuple[float, ...]]:
        """Fading within shares of the usual speed."""
        usual = float(seen.speed[self.dof(model)])
        return super().grids(model, seen) | {"vs": tuple(float(np.clip(s * usual, 0.02, 5.0)) for s in FADING)}

    def begin(self, model: mujoco.MjModel, v: Array) -> Array:
        """As compiled."""
        return self.begin_compiled(v[..., self.dof(model), None])[0]

    def advance(
        self, model: mujoco.MjModel, memory: Array, t: Array, q: Array, v: Array, u: Array, h: float
    ) -> tuple[Array, Array]:
        """Exact for constant speed."""
        dof, out = self.dof(model), np.zeros_like(v)
        out[..., dof], bent = self.slide(memory[..., 0], v[..., dof], h)
        return out, bent[..., None]

    def slipping(self, speed: Array) -> Array:
        """Deflection of bristles that slip, rad, at speeds `[...]`."""
        xp = functions(speed)
        return (self.c + self.extra * xp.exp(-((speed / self.vs) ** 2))) / self.s * xp.sign(speed)

    def begin_compiled(self, v: Array) -> tuple[Array, ...]:
        """Bristles slip as they do in fast motion: at rest they bend further only as far as the joint slides."""
        return (self.c / self.s * functions(v).sign(v),)

    def remembered(self, memory: tuple[Array, ...], v: Array, motor: Array, h: float) -> tuple[Array, ...]:
        """Deflection of the bristles."""
        return (self.slide(memory[0], v, h)[1],)

    def compiled_force(
        self, memory: tuple[Array, ...], t: Array, q: Array, v: Array, motor: Callable[[], Array], h: float
    ) -> tuple[Array | None, tuple[Array, ...]]:
        """Force of the bristles."""
        force, bent = self.slide(memory[0], v, h)
        return force, (bent,)

    def slide(self, bent: Array, speed: Array, h: float) -> tuple[Array, Array]:
        """Mean torque and deflection after a step at constant speed; all `[...]`."""
        xp, steady = functions(speed), self.slipping(speed)
        there = xp.asarray(self.c + self.extra > 0)
        decay = xp.maximum(h * abs(speed) / xp.maximum(abs(steady), 1e-12), 1e-9)
        after = steady + (bent - steady) * xp.exp(-decay)
        mean = steady + (bent - steady) * -xp.expm1(-decay) / decay
        torque = -self.s * mean - self.d * (after - bent) / h
        return xp.where(there, torque, 0.0), xp.where(there, after, bent)
