"""What a controller reads from a world model, and the model's equations of motion written for control."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model import physics
from keycld_model.added_effects import AddedEffects
from keycld_model.numerics import rk4_step

KEYPOINT_NOISE = 0.004
"""Standard deviation of the estimator's keypoints at least, image units."""


class LearnedModel(Protocol):
    """What an agent needs from a world model; `keycld_model.WorldModel` has it.

    Attributes:
        system: name or environment id of the system it was trained on, or None.
        mechanism: the declared mechanism.
        constrained: its rods and sliders hold the masses in the model's equations of motion, too.
        masses: `[K]` of keypoints, or `[K + L]` with those of rods between two joints; that they sum to 1 fixes the
            common scale of (M, V, g).
        level: `[c]` values of the constraints.
        pivot: `[2]`, image units.
        timestep: seconds per frame.
        image_shape: (H, W).
        keypoints_fn: image `[H, W, 3]`, uint8 or float in 0 to 1, to keypoints `[n]`.
        render_fn: positions `[n]` to image `[H, W, 3]`, float in 0 to 1.
        potential_energy_fn: positions `[n]` to V (scalar).
        input_matrix_fn: positions `[n]` to g `[n, m]`.
        added: `AddedEffects`, physics beside what was learned, or None; V has gravity's.
    """

    @property
    def system(self) -> str | None: ...  # noqa: D102
    @property
    def mechanism(self) -> Mechanism: ...  # noqa: D102
    @property
    def constrained(self) -> bool: ...  # noqa: D102
    @property
    def masses(self) -> Any: ...  # noqa: D102
    @property
    def level(self) -> Any: ...  # noqa: D102
    @property
    def pivot(self) -> Any: ...  # noqa: D102
    @property
    def timestep(self) -> float: ...  # noqa: D102
    @property
    def image_shape(self) -> tuple[int, int]: ...  # noqa: D102
    @property
    def keypoints_fn(self) -> Callable[[Array], Array]: ...  # noqa: D102
    @property
    def render_fn(self) -> Callable[[Array], Array]: ...  # noqa: D102
    @property
    def potential_energy_fn(self) -> Callable[[Array], Array]: ...  # noqa: D102
    @property
    def input_matrix_fn(self) -> Callable[[Array], Array]: ...  # noqa: D102
    @property
    def added(self) -> Any: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Plant:
    """The mechanics of a world model; see `LearnedModel` for the fields.

    Attributes:
        keypoint_noise: standard deviation of keypoints that are found in an image, image units.
    """

    mechanism: Mechanism
    masses: Array
    level: Array
    pivot: Array
    timestep: float
    potential_energy: Callable[[Array], Array]
    input_matrix: Callable[[Array], Array]
    added: AddedEffects | None = None
    keypoint_noise: float = KEYPOINT_NOISE

    @classmethod
    def of(cls, model: LearnedModel) -> "Plant":
        """Take from a world model what concerns motion."""
        return cls(
            model.mechanism,
            jnp.asarray(model.masses),
            jnp.asarray(model.level),
            jnp.asarray(model.pivot),
            model.timestep,
            model.potential_energy_fn,
            model.input_matrix_fn,
            model.added,
        )

    def momentum(self, v: Array) -> Array:
        """M v `[n]` of velocities `[n]`, or of whatever is to be measured in the metric of M."""
        return physics.momentum(self.mechanism, self.masses, v)

    def force(self, x: Array, v: Array) -> Array:
        """`[n]` of what acts beside motors, constraints, and dry friction."""
        learned = -jax.grad(self.potential_energy)(x)
        return learned if self.added is None else learned + self.added.force(x, v)


class Response(NamedTuple):
    """The acceleration of the model as an affine function of the action: x'' = free + inputs @ u.

    Attributes:
        free: `[n]` acceleration without action, image units per second squared.
        inputs: `[n, m]` acceleration per unit of action. Its columns are possible motions of the mechanism.
        momenta: `[n, m]` M A, since M is the metric in which accelerations are compared.
    """

    free: Array
    inputs: Array
    momenta: Array

    @property
    def gram(self) -> Array:
        """H = A' M A, `[m, m]`; entry i, j is what action j changes in the acceleration of actuator i."""
        return self.momenta.T @ self.inputs

    def demand(self, acceleration: Array) -> Array:
        """A' M (`acceleration` - free), `[m]`: H u equals this where u achieves the acceleration `[n]` exactly."""
        return self.momenta.T @ (acceleration - self.free)


def responses(plant: Plant, x: Array, v: Array) -> tuple[Response, Response]:
    """The response in motion, and the one at rest in the same place.

    Constraint forces are solved for, so that only those components of grad V and g matter that can move the
    mechanism; the others are arbitrary in a learned model.

    Args:
        plant: the model.
        x: `[n]` positions on the manifold.
        v: `[n]` velocities.
    """
    rest = jnp.zeros_like(v)

    def accelerate(force: Array, v: Array) -> Array:
        return physics.acceleration(plant.mechanism, plant.masses, force, x, v, plant.pivot)

    inputs = jax.vmap(accelerate, (1, None), 1)(plant.input_matrix(x), rest)
    momenta = jax.vmap(plant.momentum, 1, 1)(inputs)
    moving, resting = (Response(accelerate(plant.force(x, w), w), inputs, momenta) for w in (v, rest))
    return moving, resting


def acceleration(plant: Plant, x: Array, v: Array, u: Array) -> Array:
    """Acceleration x'' `[n]` under the action u `[m]`, without dry friction."""
    force = plant.input_matrix(x) @ u + plant.force(x, v)
    return physics.acceleration(plant.mechanism, plant.masses, force, x, v, plant.pivot)


def advanced(plant: Plant, x: Array, v: Array, u: Array) -> tuple[Array, Array]:
    """Positions and velocities `[n]` a frame later, under the action u `[m]`."""
    x, v = rk4_step(lambda x, v: acceleration(plant, x, v, u), x, v, plant.timestep)
    return (x, v) if plant.added is None else plant.added.slowed(x, v, plant.timestep)


def beyond_friction(plant: Plant, x: Array, v: Array, wanted: Array) -> Array:
    """What acceleration to ask of the motors, `[n]`, so that in spite of dry friction the wanted one `[n]` comes about.

    Friction is that of the motion as it will be after a frame with the wanted acceleration, so that it is overcome from
    rest, too.
    """
    if plant.added is None:
        return wanted
    return wanted - plant.added.against_friction(x, v + plant.timestep * wanted)


def project(plant: Plant, x: Array, v: Array, iterations: int = 1) -> tuple[Array, Array]:
    """Positions `[n]` moved on to the manifold, and velocities `[n]` made tangent to it."""
    x = physics.project_position(plant.mechanism, plant.masses, plant.level, x, plant.pivot, iterations)
    return x, physics.project_velocity(plant.mechanism, plant.masses, x, v, plant.pivot)


def energy(plant: Plant, x: Array, v: Array) -> Array:
    """T + V (scalar)."""
    return physics.kinetic_energy(plant.mechanism, plant.masses, v) + plant.potential_energy(x)
