"""What identification fits, as one vector; and compiled costs of sequences in it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree

from keycld_model.config import ModelConfig
from keycld_model.modules import Parts
from keycld_model.places import rails, slide_along_rods, sliding_rods, to_keypoints
from keycld_model.training.stage import Variables

HUBER = 0.01
"""Deviation of a keypoint, image units, from which its weight falls."""
CHUNK = 90
"""Sequences whose derivatives are in memory together."""


@dataclass(frozen=True)
class Coordinates:
    """Parameters in which the valley is nearly straight.

    Forces act where keypoints were seen, wherever on the rod the mass is, and a mass at the end of a rod counts by its
    moment about the joint; so a wrong place of the mass leaves forces and inertia as they are. If it matters which of
    the masses a motor acts on, forces act on these.

    Attributes:
        config: of the model.
        slide: where masses are is fitted.
        at_masses: forces act on the masses.
        fine: steps in which a rod turns far are divided, as for predictions; from wrong masses, which make rods
            turn as they like, it takes long and finds less.
    """

    config: ModelConfig
    slide: bool
    at_masses: bool
    fine: bool = False

    @cached_property
    def parts(self) -> Parts:
        """The networks."""
        return Parts(self.config)

    @property
    def ends(self) -> Array:
        """Keypoints at the ends of rods, along which masses may be elsewhere."""
        return jnp.asarray([end for _, end in sliding_rods(self.config.mechanism)] if self.slide else [], int)

    @property
    def leaning(self) -> Array:
        """Keypoints on rails, which may be seen beside them."""
        return jnp.asarray([start for start, _ in rails(self.config.mechanism)] if self.slide else [], int)

    def unravel(self, variables: Variables) -> Callable[[Array], Any]:
        """From parameters `[p]` to those by name."""
        return ravel_pytree(self.parameters(variables))[1]

    def parameters(self, variables: Variables) -> dict[str, Array]:
        """By name; masses are logarithms."""
        dynamics, scale = variables["dynamics"], variables["rod_scale"]
        stretch, n = self._stretch(scale), 2 * self.config.mechanism.num_keypoints
        kernel = dynamics["input"]["linear"]["kernel"].reshape(n, n, -1)
        return {
            "inertia": jax.nn.log_softmax(dynamics["log_masses"]).at[self.ends].add(2 * scale[self.ends]),
            "rod_scale": scale[self.ends],
            "lean": variables["lean"][self.leaning],
            "level": dynamics["level"] / self._stretched_levels(scale),
            "potential": stretch.T @ dynamics["potential"]["linear"]["kernel"],
            **({"spring": dynamics["spring"]} if "spring" in dynamics else {}),
            "input": jnp.einsum("xi,xfu,fj->iju", stretch, kernel, stretch),
            "constant_input": stretch.T @ dynamics["input"]["linear"]["bias"].reshape(n, -1),
        }

    def variables(self, first: Variables, theta: Array) -> Variables:
        """The first variables with other parameters `[p]`; masses have sum 1."""
        p = self.unravel(first)(theta)
        scale = first["rod_scale"].at[self.ends].set(p["rod_scale"])
        lean = first["lean"].at[self.leaning].set(p["lean"])
        log_masses = p["inertia"].at[self.ends].add(-2 * p["rod_scale"])
        total = jnp.sum(jnp.exp(log_masses))
        back = jnp.linalg.inv(self._stretch(scale))
        old = first["dynamics"]
        potential, force = old["potential"], old["input"]
        kernel = jnp.einsum("ix,iju,jf->xfu", back, p["input"], back) / total
        linear = {
            "kernel": kernel.reshape(kernel.shape[0], -1),
            "bias": (back.T @ p["constant_input"] / total).reshape(-1),
        }
        dynamics = {
            **old,
            "log_masses": log_masses - jnp.log(total),
            "level": p["level"] * self._stretched_levels(scale),
            "potential": {
                **potential,
                "linear": {**potential["linear"], "kernel": back.T @ p["potential"] / total},
            },
            **({"spring": p["spring"] / total} if "spring" in p else {}),
            "input": {**force, "linear": linear},
        }
        return {**first, "dynamics": dynamics, "rod_scale": scale, "lean": lean}

    def _stretch(self, rod_scale: Array) -> Array:
        """S `[n, n]`: positions of the masses = S positions at which forces act."""
        rod_scale = jnp.zeros_like(rod_scale) if self.at_masses else rod_scale
        return slide_along_rods(self.config.mechanism, rod_scale, jnp.eye(2 * self.config.mechanism.num_keypoints)).T

    def _stretched_levels(self, rod_scale: Array) -> Array:
        """`[c]` factors on the constants of the constraints between what is seen and where the masses are."""
        ends = [end for _, end in sliding_rods(self.config.mechanism)]
        rods = [jnp.exp(2 * rod_scale[r.end]) if r.end in ends else jnp.ones(()) for r in self.config.mechanism.rods]
        return jnp.stack(rods + [jnp.ones(())] * len(self.config.mechanism.sliders))

    def _deviations(
        self, first: Variables, theta: Array, z: Array, x: Array, v: Array, keypoints: Array, actions: Array
    ) -> tuple[Array, tuple[Array, Array]]:
        """Rollout minus keypoints `[T, n]` where they were seen, and the initial state after moving it by z."""
        variables = self.variables(first, theta)
        model = self.parts.lagrangian(variables)
        basis, dof = model.tangent_space(x), self.config.mechanism.degrees_of_freedom
        state = model.project(x + basis @ z[:dof], v + basis @ z[dof:])
        positions, _ = model.rollout(*state, actions, self.config.timestep, self.fine)
        return to_keypoints(self.config.mechanism, variables, positions) - keypoints, state

    def linearise(
        self, first: Variables, theta: Array, x: Array, v: Array, keypoints: Array, actions: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Deviations `[T*n]` of a sequence, their derivatives `[T*n, p+s]`, weights `[T*n]`, and cost."""
        p = theta.shape[0]

        def deviations(q: Array) -> Array:
            return self._deviations(first, q[:p], q[p:], x, v, keypoints, actions)[0].ravel()

        q = jnp.concatenate([theta, jnp.zeros(2 * self.config.mechanism.degrees_of_freedom, theta.dtype)])
        error, jacobian = deviations(q), jax.jacfwd(deviations)(q)
        distance, cost = _huber(error)
        weight = jnp.repeat(jnp.minimum(1.0, HUBER / distance), 2) / keypoints.shape[0]
        return error, jacobian, weight, cost / keypoints.shape[0]

    def block(
        self, first: Variables, theta: Array, x: Array, v: Array, keypoints: Array, actions: Array
    ) -> tuple[Array, Array, Array]:
        """Hessian `[p+s, p+s]`, gradient `[p+s]` and cost of a sequence."""
        error, jacobian, weight, cost = self.linearise(first, theta, x, v, keypoints, actions)
        weighted = jacobian * weight[:, None]
        return weighted.T @ jacobian, weighted.T @ error, cost

    def cost(
        self, first: Variables, theta: Array, z: Array, x: Array, v: Array, keypoints: Array, actions: Array
    ) -> tuple[Array, Array, Array]:
        """Cost of a sequence after moving its initial state by z, and that state."""
        error, state = self._deviations(first, theta, z, x, v, keypoints, actions)
        return _huber(error)[1] / keypoints.shape[0], *state


@lru_cache(maxsize=8)
def programs(coordinates: Coordinates) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """`block`, `cost` and `linearise` of all sequences, compiled once for all data of a shape.

    Their arguments are those of a single sequence's, all but the first two with a leading axis of sequences.
    """

    def blocks(first: Variables, theta: Array, *rows: Array) -> tuple[Array, Array, Array]:
        return jax.lax.map(lambda row: coordinates.block(first, theta, *row), rows, batch_size=CHUNK)

    def costs(first: Variables, theta: Array, *rows: Array) -> tuple[Array, Array, Array]:
        return jax.vmap(lambda *row: coordinates.cost(first, theta, *row))(*rows)

    def linearised(first: Variables, theta: Array, *rows: Array) -> tuple[Array, Array, Array, Array]:
        return jax.lax.map(lambda row: coordinates.linearise(first, theta, *row), rows, batch_size=CHUNK)

    return jax.jit(blocks), jax.jit(costs), jax.jit(linearised)


def _huber(error: Array) -> tuple[Array, Array]:
    """Distances of all keypoints in all frames, and the sum of their Huber losses."""
    distance = jnp.sqrt(jnp.sum(error.reshape(-1, 2) ** 2, axis=-1) + 1e-12)
    near = distance < HUBER
    return distance, jnp.sum(jnp.where(near, 0.5 * distance**2, HUBER * (distance - 0.5 * HUBER)))
