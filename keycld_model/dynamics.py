"""What moves keypoints from frame to frame, whatever gives their accelerations."""

from abc import abstractmethod

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model import physics
from keycld_model.numerics import rk4_step


class Dynamics(nnx.Module):
    """Second-order dynamics in keypoint coordinates.

    Unbatched; positions `x` are `[n]`, n = 2K, image units; time is in seconds. Nothing holds the keypoints unless a
    subclass says so.

    Args:
        mechanism: the declaration.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.level = nnx.Param(jnp.zeros(mechanism.num_constraints))
        self.pivot = nnx.Param(jnp.asarray(mechanism.pivot, jnp.float32))

    @abstractmethod
    def acceleration(self, x: Array, v: Array, u: Array) -> Array:
        """x'' `[n]` under actions u `[m]`."""

    def constraint(self, x: Array) -> Array:
        """Phi(x), `[c]`; `level` on every configuration the mechanism can take."""
        return physics.constraint(self.mechanism, x, self.pivot[...])

    def project(self, x: Array, v: Array, iterations: int = 3) -> tuple[Array, Array]:
        """Nearest state that meets the constraints that act: none do."""
        return x, v

    def tangent_space(self, x: Array) -> Array:
        """Orthonormal basis `[n, dof]` of the directions in which a configuration can move."""
        return jnp.eye(x.shape[0], dtype=x.dtype)

    def step(self, x: Array, v: Array, u: Array, step_size: float) -> tuple[Array, Array]:
        """One Runge-Kutta step under a held action."""
        return rk4_step(lambda x, v: self.acceleration(x, v, u), x, v, step_size)

    def fine_step(self, x: Array, v: Array, u: Array, step_size: float) -> tuple[Array, Array]:
        """The same, in parts where a subclass knows that it should be. Not to be differentiated backwards."""
        return self.step(x, v, u, step_size)

    def rollout(self, x: Array, v: Array, actions: Array, timestep: float, fine: bool = False) -> tuple[Array, Array]:
        """Integrate from one frame to the next.

        Args:
            x: `[n]` positions at the first frame; projected before use.
            v: `[n]` velocities.
            actions: `[T-1, m]`, held between frames.
            timestep: seconds between frames.
            fine: take `fine_step`, for predictions; one step per frame, for training, is differentiable.

        Returns:
            Positions and velocities at all frames, `[T, n]` each.
        """
        first, step = self.project(x, v), self.fine_step if fine else self.step

        def advance(state: tuple[Array, Array], u: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
            state = step(*state, u, timestep)
            return state, state

        _, (xs, vs) = jax.lax.scan(advance, first, actions)
        return jnp.concatenate([first[0][None], xs]), jnp.concatenate([first[1][None], vs])
