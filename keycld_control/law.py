"""Control laws: which action brings a mechanism, seen as keypoints, to a target.

All but the paper's literal one share a form: say which acceleration is wanted, and let the model choose the action
that comes closest to it. With x'' = a + A u (`Response`) and the metric of the mass matrix M,

    u = argmin over low <= u <= high of |a + A u - wanted|_M .

Without the bounds this is (A'MA)^-1 A'M (wanted - a), which equals (N'g)^-1 N' [grad V + M wanted] for any basis N of
the null space of D Phi when the mechanism is at rest: the paper's law, projected on the constraint manifold.
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array

from keycld_control.plant import Plant, Response, beyond_friction, responses
from keycld_control.skeleton import centripetal_acceleration, turning_error
from keycld_model.numerics import bounded_minimum, solve_positive_definite

Law = Literal["turning", "projected", "paper"]
REFERENCE_SPEED = 2.0
"""Keypoints are not sent to their target faster than this, image units per second."""


def turning_action(
    plant: Plant, x: Array, v: Array, target: Array, kp: float | Array, kd: float | Array, low: Array, high: Array
) -> Array:
    """Turn every rod to its target angle and move every root to its target, each as a damped oscillator.

    Wanted is x'' = -kd (v - v_ref) + centripetal part, with v_ref = -kp/kd `turning_error`, no faster than
    `REFERENCE_SPEED`. Where the bounds permit, every rod's angle then obeys q'' = -kp q - kd q': no configuration but
    the target is an equilibrium.

    Args:
        plant: the model.
        x: `[n]` positions on the manifold.
        v: `[n]` velocities.
        target: `[n]` positions on the manifold.
        kp: stiffness, 1/s^2.
        kd: damping, 1/s.
        low: `[m]` lower bounds of the action.
        high: `[m]` upper bounds.

    Returns:
        `[m]` action within the bounds.
    """
    moving, _ = responses(plant, x, v)
    wanted = turning_acceleration(plant, x, v, target, kp, kd)
    return nearest_action(moving, beyond_friction(plant, x, v, wanted), low, high)


def projected_action(
    plant: Plant, x: Array, v: Array, target: Array, kp: float | Array, kd: float | Array, low: Array, high: Array
) -> Array:
    """The paper's law (equation 15) on the manifold, u = (N'g)^-1 N' [grad V - M (kp (x - x*) + kd v)].

    The mass matrix gives the gains the units 1/s^2 and 1/s on every mechanism. T + kp |x - x*|^2_M / 2 never
    increases while the bounds do not bind. Other critical points of |x - x*| are unstable equilibria, for instance
    hanging straight down. Arguments and result as in `turning_action`.
    """
    _, resting = responses(plant, x, v)
    return nearest_action(resting, beyond_friction(plant, x, v, -kp * (x - target) - kd * v), low, high)


def paper_action(
    plant: Plant, x: Array, v: Array, target: Array, kp: float | Array, kd: float | Array, low: Array, high: Array
) -> Array:
    """The paper's equation 15 to the letter, u = (g'g)^-1 g' [grad V - kp (x - x*)] - kd g'v, clipped.

    It mixes in the components of grad V and g along the constraints, which data cannot determine. Arguments and
    result as in `turning_action`, except that kp and kd have the units of energy / length^2 and of action.
    """
    g = plant.input_matrix(x)
    force = jax.grad(plant.potential_energy)(x) - kp * (x - target)
    return jnp.clip(solve_positive_definite(g.T @ g, g.T @ force) - kd * g.T @ v, low, high)


def turning_acceleration(
    plant: Plant,
    x: Array,
    v: Array,
    target: Array,
    kp: float | Array,
    kd: float | Array,
    speed: float = REFERENCE_SPEED,
) -> Array:
    """What `turning_action` wants, `[n]`; `speed` limits the reference velocity, image units per second."""
    reference = -kp / kd * turning_error(plant.mechanism, x, target, plant.pivot)
    fastest = jnp.sqrt(jnp.max(jnp.sum(reference.reshape(-1, 2) ** 2, axis=1)))
    reference = reference * jnp.minimum(1.0, speed / jnp.maximum(fastest, 1e-9))
    return kd * (reference - v) + centripetal_acceleration(plant.mechanism, x, v, plant.pivot)


def unbounded_action(response: Response, wanted: Array) -> Array:
    """The action `[m]` that achieves the wanted acceleration `[n]`, in the least-squares sense of the metric M."""
    return solve_positive_definite(response.gram, response.demand(wanted))


def nearest_action(response: Response, wanted: Array, low: Array, high: Array) -> Array:
    """The action within bounds whose acceleration is nearest to the wanted one in the metric M (Gauss' principle).

    Unlike clipping, it lets the free actuators make up for the saturated ones. A convex quadratic programme, solved by
    coordinate descent; low[i] = high[i] prescribes action i.

    Args:
        response: the model at the present state.
        wanted: `[n]` acceleration.
        low: `[m]` lower bounds.
        high: `[m]` upper bounds.

    Returns:
        `[m]`.
    """
    return bounded_minimum(response.gram, response.demand(wanted), low, high)


LAWS = {"turning": turning_action, "projected": projected_action, "paper": paper_action}
