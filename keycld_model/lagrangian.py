"""The learned Lagrangian: point masses, V(x), g(x), with or without constraints."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model import physics
from keycld_model.dynamics import Dynamics
from keycld_model.nets import MLP
from keycld_model.numerics import null_space
from keycld_model.physics import INTEGRATORS, Integrator, PointMasses, in_turns
from keycld_model.places import inner_rods

FINE = in_turns(INTEGRATORS["projected"])


class Lagrangian(Dynamics):
    """Constrained Lagrangian dynamics in keypoint coordinates (KeyCLD paper, equation 6).

    From motion alone (M, V, g) are known only up to one common factor. It is fixed by sum(masses) = 1, so V is energy
    per total mass (image units squared per second squared).

    Args:
        mechanism: the declaration.
        hidden: width of the hidden layers of V and g.
        force_scale: factor on the outputs of V and g.
        kernel_scale: standard deviation of their initial weights, or None.
        linear: give them a linear term.
        rngs: initialisation.
        constrained: rods and sliders hold the masses; without them this is the paper's KeyCLD-NC.
        springs: give V a spring along each rail, too.
        rod_masses: give each rod between two joints a mass in its middle, too.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        hidden: int,
        force_scale: float,
        kernel_scale: float | None,
        linear: bool,
        rngs: nnx.Rngs,
        constrained: bool = True,
        springs: bool = False,
        rod_masses: bool = False,
    ) -> None:
        super().__init__(mechanism)
        n = 2 * mechanism.num_keypoints
        self.held = mechanism if constrained else replace(mechanism, rods=(), sliders=())
        rods = inner_rods(self.held) if rod_masses else []
        self.log_masses = nnx.Param(jnp.zeros(mechanism.num_keypoints + len(rods)))
        self.potential = MLP(n, hidden, 1, force_scale, kernel_scale, linear, rngs)
        self.spring = nnx.Param(jnp.zeros(len(mechanism.sliders))) if springs and mechanism.sliders else None
        self.input = MLP(n, hidden, n * mechanism.num_actions, force_scale, kernel_scale, linear, rngs)

    @property
    def masses(self) -> Array:
        """`[K]` of keypoints, or `[K + L]` with those of rods between two joints; positive, of sum 1."""
        return nnx.softmax(self.log_masses[...])

    @property
    def stiffness(self) -> Array:
        """`[S]` of the spring along each slider's rail, per total mass, 1/s².

        It is at rest with the keypoint at the pivot; if the real one is so elsewhere, V's linear term has the rest.
        """
        if self.spring is None:
            return jnp.zeros(len(self.mechanism.sliders))
        return self.potential.output_scale * self.spring[...]

    def potential_energy(self, x: Array) -> Array:
        """V(x), scalar."""
        if self.spring is None:
            return self.potential(x)[0]
        return self.potential(x)[0] + 0.5 * self.stiffness @ self.along_rails(x) ** 2

    def along_rails(self, x: Array) -> Array:
        """`[S]` distance of each slider's keypoint from the pivot along its rail."""
        points = x.reshape(-1, 2) - self.pivot[...]
        along = [points[slider.keypoint] @ jnp.asarray(slider.along) for slider in self.mechanism.sliders]
        return jnp.asarray(along, x.dtype)

    def input_matrix(self, x: Array) -> Array:
        """g(x), `[n, m]`: force on the keypoints per unit of each action."""
        return self.input(x).reshape(x.shape[0], self.mechanism.num_actions)

    def force(self, x: Array, u: Array) -> Array:
        """f = g(x) u - grad V(x), `[n]`: what acts on the keypoints beside the constraints."""
        return self.input_matrix(x) @ u - jax.grad(self.potential_energy)(x)

    def acceleration(self, x: Array, v: Array, u: Array) -> Array:
        """x'' `[n]` under actions u `[m]` (equation 6)."""
        return self.points.acceleration(self.force(x, u), x, v)

    @property
    def points(self) -> PointMasses:
        """The masses and what holds them."""
        return PointMasses(self.held, self.masses, self.level[...], self.pivot[...])

    def project(self, x: Array, v: Array, iterations: int = 3) -> tuple[Array, Array]:
        """Nearest state that meets the constraints, in the metric of the masses."""
        return self.points.project(x, v, iterations)

    def step(
        self, x: Array, v: Array, u: Array, step_size: float, integrator: Integrator = INTEGRATORS["projected"]
    ) -> tuple[Array, Array]:
        """One step under a held action; unless told otherwise by Runge-Kutta, then projected on the constraints."""
        return integrator(self.points, lambda x: self.force(x, u), x, v, step_size)

    def fine_step(self, x: Array, v: Array, u: Array, step_size: float) -> tuple[Array, Array]:
        """The same in parts where a rod turns fast."""
        return self.step(x, v, u, step_size, FINE)

    def tangent_space(self, x: Array) -> Array:
        """Orthonormal basis `[n, dof]` of the directions in which a configuration can move."""
        return null_space(physics.constraint_jacobian(self.held, x, self.pivot[...]))
