"""The learned constrained Lagrangian: point masses, V(x), g(x), and the constants of the constraints."""

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model import physics
from keycld_model.nets import MLP
from keycld_model.numerics import null_space, rk4_step


class Dynamics(nnx.Module):
    """Constrained Lagrangian dynamics in keypoint coordinates (KeyCLD paper, equation 6).

    Unbatched; positions `x` are `[n]`, n = 2K, image units; time is in seconds. From motion alone (M, V, g) are known
    only up to one common factor. It is fixed by sum(masses) = 1, so V is energy per total mass (image units squared
    per second squared).

    Args:
        mechanism: the declaration.
        hidden: width of the hidden layers of V and g.
        force_scale: factor on the outputs of V and g.
        kernel_scale: standard deviation of their initial weights, or None.
        linear: give them a linear term.
        rngs: initialisation.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        hidden: int,
        force_scale: float,
        kernel_scale: float | None,
        linear: bool,
        rngs: nnx.Rngs,
    ) -> None:
        n = 2 * mechanism.num_keypoints
        self.mechanism = mechanism
        self.log_masses = nnx.Param(jnp.zeros(mechanism.num_keypoints))
        self.potential = MLP(n, hidden, 1, force_scale, kernel_scale, linear, rngs)
        self.input = MLP(n, hidden, n * mechanism.num_actions, force_scale, kernel_scale, linear, rngs)
        self.level = nnx.Param(jnp.zeros(mechanism.num_constraints))
        self.pivot = nnx.Param(jnp.asarray(mechanism.pivot, jnp.float32))

    @property
    def masses(self) -> Array:
        """`[K]`, positive, of sum 1."""
        return nnx.softmax(self.log_masses[...])

    def potential_energy(self, x: Array) -> Array:
        """V(x), scalar."""
        return self.potential(x)[0]

    def input_matrix(self, x: Array) -> Array:
        """g(x), `[n, m]`: force on the keypoints per unit of each action."""
        return self.input(x).reshape(x.shape[0], self.mechanism.num_actions)

    def constraint(self, x: Array) -> Array:
        """Phi(x), `[c]`; `level` on every configuration the mechanism can take."""
        return physics.constraint(self.mechanism, x, self.pivot[...])

    def acceleration(self, x: Array, v: Array, u: Array) -> Array:
        """x'' `[n]` under actions u `[m]` (equation 6)."""
        force = self.input_matrix(x) @ u - jax.grad(self.potential_energy)(x)
        return physics.acceleration(self.mechanism, self.masses, force, x, v, self.pivot[...])

    def project(self, x: Array, v: Array, iterations: int = 3) -> tuple[Array, Array]:
        """Nearest state that meets the constraints, in the metric of the masses."""
        x = physics.project_position(self.mechanism, self.masses, self.level[...], x, self.pivot[...], iterations)
        return x, physics.project_velocity(self.mechanism, self.masses, x, v, self.pivot[...])

    def tangent_space(self, x: Array) -> Array:
        """Orthonormal basis `[n, dof]` of the directions in which a configuration can move."""
        return null_space(physics.constraint_jacobian(self.mechanism, x, self.pivot[...]))

    def step(self, x: Array, v: Array, u: Array, step_size: float) -> tuple[Array, Array]:
        """One Runge-Kutta step under a held action, then projection of position and velocity."""
        x, v = rk4_step(lambda x, v: self.acceleration(x, v, u), x, v, step_size)
        return self.project(x, v, iterations=1)

    def rollout(self, x: Array, v: Array, actions: Array, timestep: float) -> tuple[Array, Array]:
        """Integrate from one frame to the next.

        Args:
            x: `[n]` positions at the first frame; projected before use.
            v: `[n]` velocities.
            actions: `[T-1, m]`, held between frames.
            timestep: seconds between frames.

        Returns:
            Positions and velocities at all frames, `[T, n]` each.
        """
        first = self.project(x, v)

        def advance(state: tuple[Array, Array], u: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
            state = self.step(*state, u, timestep)
            return state, state

        _, (xs, vs) = jax.lax.scan(advance, first, actions)
        return jnp.concatenate([first[0][None], xs]), jnp.concatenate([first[1][None], vs])
