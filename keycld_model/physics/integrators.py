"""One time step of point masses under constraints: four ways to stay on them, or not.

| integrator | order | positions | velocities | energy |
|---|---|---|---|---|
| `plain` | 4 | drift | drift | drifts |
| `velocity_projected` | 4 | drift, slowly | held | drifts |
| `projected` | 4 | held | held | drifts, as the step's fourth power |
| `rattle` | 2 | held | held | oscillates, and does not drift: symmetric |
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from keycld_envs.mechanism import Mechanism
from keycld_model.numerics import rk4_step
from keycld_model.physics.constraints import constraint, constraint_curvature, constraint_jacobian
from keycld_model.physics.lagrangian import acceleration
from keycld_model.physics.masses import divided, lumped, momentum
from keycld_model.physics.projection import project_position, project_velocity

NEWTON = 4
"""Newton steps for the multipliers of a RATTLE step; they start from those of the accelerations."""
TURN, MOST_PARTS = 0.1, 100
"""rad that a rod may turn in a part of a step; and how many parts there are at most."""


@dataclass(frozen=True)
class PointMasses:
    """What moves, and what holds it.

    Attributes:
        mechanism: the declaration.
        masses: `[K]` or `[K + L]`; see `keycld_model.physics.masses`.
        level: `[c]` values of Phi.
        pivot: `[2]` position of the fixed pivot, image units.
    """

    mechanism: Mechanism
    masses: Array
    level: Array
    pivot: Array

    @property
    def lumped(self) -> Array:
        """Masses `[K]` of the keypoints, with half of each rod's at either end."""
        return lumped(self.mechanism, self.masses)

    def momentum(self, v: Array) -> Array:
        """M v `[n]` of velocities `[n]`."""
        return momentum(self.mechanism, self.masses, v)

    def acceleration(self, force: Array, x: Array, v: Array) -> Array:
        """x'' `[n]` under applied forces `[n]`."""
        return acceleration(self.mechanism, self.masses, force, x, v, self.pivot)

    def project(self, x: Array, v: Array, iterations: int) -> tuple[Array, Array]:
        """Nearest state on the constraints, in the metric of the masses."""
        x = project_position(self.mechanism, self.masses, self.level, x, self.pivot, iterations)
        return x, self.project_velocity(x, v)

    def project_velocity(self, x: Array, v: Array) -> Array:
        """Nearest velocity that keeps the constraints."""
        return project_velocity(self.mechanism, self.masses, x, v, self.pivot)

    def turning(self, v: Array) -> Array:
        """How fast the fastest rod turns, rad/s, scalar."""
        rods = len(self.mechanism.rods)
        squares = constraint_curvature(self.mechanism, v)[:rods] / (2 * self.level[:rods])
        return jnp.sqrt(jnp.max(squares, initial=0.0))


Force = Callable[[Array], Array]
Integrator = Callable[[PointMasses, Force, Array, Array, float | Array], tuple[Array, Array]]
"""(point masses, force `[n]` of positions `[n]`, positions, velocities, step size in s) -> positions and velocities."""


def plain(points: PointMasses, force: Force, x: Array, v: Array, step_size: float | Array) -> tuple[Array, Array]:
    """A classical Runge-Kutta step of the equations of motion (paper, equation 6), which hold Phi'' at zero only."""
    return rk4_step(lambda x, v: points.acceleration(force(x), x, v), x, v, step_size)


def velocity_projected(
    points: PointMasses, force: Force, x: Array, v: Array, step_size: float | Array
) -> tuple[Array, Array]:
    """The same, then velocities projected on D Phi v = 0 (paper, appendix A.9)."""
    x, v = plain(points, force, x, v, step_size)
    return x, points.project_velocity(x, v)


def projected(points: PointMasses, force: Force, x: Array, v: Array, step_size: float | Array) -> tuple[Array, Array]:
    """The same, then positions projected on Phi = level, and velocities (Hairer et al., 2006, section IV.4)."""
    return points.project(*plain(points, force, x, v, step_size), 1)


def rattle(points: PointMasses, force: Force, x: Array, v: Array, step_size: float | Array) -> tuple[Array, Array]:
    """RATTLE (Andersen, 1983): symmetric, symplectic, and on the constraints at every step."""
    h, mechanism, pivot = step_size, points.mechanism, points.pivot
    # Its multipliers are those of the acceleration to first order.
    half = v + 0.5 * h * points.acceleration(force(x), x, v)
    if mechanism.num_constraints:
        pull = divided(mechanism, points.masses, constraint_jacobian(mechanism, x, pivot)).T

        def newton(half: Array, _: None) -> tuple[Array, None]:
            moved = x + h * half
            error = constraint(mechanism, moved, pivot) - points.level
            slope = constraint_jacobian(mechanism, moved, pivot) @ pull
            return half - pull @ jnp.linalg.solve(slope, error) / h, None

        half, _ = jax.lax.scan(newton, half, length=NEWTON)
    x = x + h * half
    return x, points.project_velocity(x, half + 0.5 * h * divided(mechanism, points.masses, force(x)))


def in_parts(integrator: Integrator, parts: int | Array) -> Integrator:
    """The same in some steps of equal size; not to be differentiated backwards if their number is not fixed."""

    def step(points: PointMasses, force: Force, x: Array, v: Array, step_size: float | Array) -> tuple[Array, Array]:
        def one(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
            return integrator(points, force, state[0], state[1], step_size / parts)

        return jax.lax.fori_loop(0, parts, one, (x, v))

    return step


def in_turns(integrator: Integrator, turn: float = TURN) -> Integrator:
    """The same in as many equal steps as keep every rod from turning further than so many rad in one.

    Fourth-order steps of 0.02 s brake a free rod of 25 rad/s by a percent in 2 s. Not to be differentiated backwards.
    """

    def step(points: PointMasses, force: Force, x: Array, v: Array, step_size: float | Array) -> tuple[Array, Array]:
        turned = jax.lax.stop_gradient(points.turning(v)) * step_size / turn
        parts = jnp.clip(jnp.nan_to_num(jnp.ceil(turned), nan=1), 1, MOST_PARTS).astype(int)
        return in_parts(integrator, parts)(points, force, x, v, step_size)

    return step


INTEGRATORS: dict[str, Integrator] = {
    "plain": plain,
    "velocity_projected": velocity_projected,
    "projected": projected,
    "rattle": rattle,
}
