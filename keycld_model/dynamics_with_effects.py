"""How keypoints move where effects are added to a learned Lagrangian."""

import jax
from jax import Array

from keycld_model.added_effects import AddedEffects
from keycld_model.dynamics import Dynamics
from keycld_model.lagrangian import Lagrangian
from keycld_model.numerics import rk4_step
from keycld_model.physics import in_turns


class DynamicsWithEffects(Dynamics):
    """A Lagrangian's dynamics with effects; `u` is what motors make of actions, see `AddedEffects.at_motors`.

    Args:
        lagrangian: constrained point masses.
        added: the effects.
    """

    def __init__(self, lagrangian: Lagrangian, added: AddedEffects) -> None:
        self.mechanism, self.lagrangian, self.added = lagrangian.mechanism, lagrangian, added

    def acceleration(self, x: Array, v: Array, u: Array) -> Array:
        """x'' `[n]` under what motors do, without dry friction."""
        turned = jax.grad(self.added.potential_energy)(x)
        return self.lagrangian.points.acceleration(self.lagrangian.force(x, u) - turned + self.added.force(x, v), x, v)

    def project(self, x: Array, v: Array, iterations: int = 3) -> tuple[Array, Array]:
        """Nearest state that meets the constraints."""
        return self.lagrangian.project(x, v, iterations)

    def step(self, x: Array, v: Array, u: Array, step_size: float | Array) -> tuple[Array, Array]:
        """A step without dry friction, projected on the constraints, then the friction."""
        x, v = rk4_step(lambda x, v: self.acceleration(x, v, u), x, v, step_size)
        return self.added.slowed(*self.project(x, v, 1), step_size)

    def fine_step(self, x: Array, v: Array, u: Array, step_size: float) -> tuple[Array, Array]:
        """The same in parts where a rod turns fast."""
        step = in_turns(lambda points, force, x, v, h: self.step(x, v, u, h))
        return step(self.lagrangian.points, lambda x: x, x, v, step_size)

    def tangent_space(self, x: Array) -> Array:
        """Orthonormal basis `[n, dof]` of the directions in which a configuration can move."""
        return self.lagrangian.tangent_space(x)
