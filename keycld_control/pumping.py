"""Swing-up where an actuator is too weak to lift the mechanism: gather energy first, then catch.

One actuator pumps, the one that lacks most. The others hold the mechanism in the shape it has at the target, so that it
moves along a curve: the configurations reached from the target when only the pumping actuator moves (for an acrobot
with a weak shoulder, the straight arm at every angle). On that curve it is a pendulum with one degree of freedom. The
pumping actuator pushes in the direction of its motion, and at rest downhill, until the learned T + V is a little above
the highest V on the curve, and always as hard as dry friction brakes, where the model is told of any. Then every swing
passes the target, where gravity is weak enough for the control law itself.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_control.law import nearest_action, turning_acceleration, unbounded_action
from keycld_control.plant import Plant, Response, beyond_friction, energy, project, responses
from keycld_control.skeleton import turned

MARGIN = 0.95
"""An actuator lifts directly if gravity and dry friction ask for at most this share of its limit."""
POSES = 1024
CURVE_STEP, CURVE_POINTS = 0.02, 400
"""Distance of neighbouring points of the curve, image units, and their number in each direction."""
EXCESS = 0.02
"""Energy beyond the highest potential energy of the curve, as a share of the range of V on it."""
BAND = 0.05
"""Pumping weakens within this share of the range of V from the wanted energy."""
SLOW, LEVEL = 0.02, 0.2
"""A mechanism is at rest below so many image units per second, and hangs where gravity accelerates it by fewer image
units per second squared, as a pendulum within some hundredths of a radian does."""
RELEASE = 1.2
"""A caught mechanism is let go when gravity asks for more than this multiple of a limit."""


class PumpState(NamedTuple):
    """What pumping remembers from frame to frame.

    Attributes:
        caught: whether the control law is at work (scalar bool).
        direction: last direction of motion of the pumping actuator, 1 or -1.
    """

    caught: Array
    direction: Array


class Pump(NamedTuple):
    """A plan for gathering energy; see the module.

    Attributes:
        actuator: index of the pumping actuator.
        curve: `[P, n]` configurations in the target's shape.
        energy: energy wanted.
        span: range of the potential energy on the curve.
        slow: rate of the pumping actuator under which it is at rest, and starts downhill.
        level: acceleration of that rate by gravity, under which there is no slope, and it keeps its direction.
        low: `[m]` lower bounds of the action, once commands have arrived.
        high: `[m]` upper bounds.
    """

    actuator: int
    curve: Array
    energy: float
    span: float
    slow: float
    level: float
    low: Array
    high: Array


def gravity_load(plant: Plant, target: Array, low: Array, high: Array, seed: int = 0) -> NDArray[np.float64]:
    """The greatest share of its limit that each actuator needs to lift the mechanism slowly, in any configuration.

    That is what gravity asks for, and dry friction where a corrected model has it.

    Args:
        plant: the model.
        target: `[n]` positions on the manifold.
        low: `[m]` lower bounds of the action, negative.
        high: `[m]` upper bounds, positive.
        seed: of the configurations tried, the target with its rods turned at random.

    Returns:
        `[m]`.
    """
    rods = len(plant.mechanism.rods)
    angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, (POSES, rods)).astype(np.float32)

    def load(angles: Array) -> Array:
        x, rest = project(plant, turned(plant.mechanism, target, angles, plant.pivot), jnp.zeros_like(target), 3)
        _, resting = responses(plant, x, rest)
        up = jnp.sign(unbounded_action(resting, rest))
        lifting = resting.inputs @ jnp.linalg.solve(resting.gram, up.astype(x.dtype))
        u = unbounded_action(resting, beyond_friction(plant, x, lifting, rest))
        return jnp.maximum(u / high, u / low)

    return np.asarray(jax.jit(jax.vmap(load))(angles), np.float64).max(axis=0)


def plan_pumping(plant: Plant, target: Array, low: Array, high: Array) -> Pump | None:
    """Decide from the learned model whether to pump, and how; arguments as in `gravity_load`.

    Returns:
        The plan, or None if the actuators can lift the mechanism directly from anywhere.
    """
    load = gravity_load(plant, target, low, high)
    if (load <= MARGIN).all():
        return None
    actuator = int(load.argmax())

    def follow(x: Array, step: Array) -> tuple[Array, Array]:
        response, _ = responses(plant, x, jnp.zeros_like(x))
        v = response.inputs @ jnp.linalg.solve(response.gram, jnp.eye(len(low), dtype=x.dtype)[actuator])
        v = v / jnp.sqrt(jnp.max(jnp.sum(v.reshape(-1, 2) ** 2, axis=1)))
        x, _ = project(plant, x + step * v, v, iterations=2)
        return x, x

    @jax.jit
    def trace(x: Array) -> tuple[Array, Array]:
        sides = [jax.lax.scan(follow, x, jnp.full(CURVE_POINTS, step))[1] for step in (-CURVE_STEP, CURVE_STEP)]
        curve = jnp.concatenate([sides[0][::-1], x[None], sides[1]])
        potential = jax.vmap(plant.potential_energy)(curve)
        ends = ~jnp.isfinite(potential)  # beyond a pose in which motors do not act independently, for a poor model
        return jnp.where(ends[:, None], x, curve), jnp.where(ends, plant.potential_energy(x), potential)

    curve, potential = trace(target)
    span = float(potential.max() - potential.min())
    rate = float(jnp.abs(plant.input_matrix(target)[:, actuator]).max())
    enough = float(potential.max()) + EXCESS * span
    return Pump(actuator, curve, enough, span, SLOW * rate, LEVEL * rate, jnp.asarray(low), jnp.asarray(high))


def overcoming_friction(plant: Plant, response: Response, x: Array, v: Array) -> Array:
    """The action `[m]` that undoes dry friction at a velocity `[n]`."""
    rest = jnp.zeros_like(x)
    if plant.added is None:
        return jnp.zeros(response.inputs.shape[1], x.dtype)
    return unbounded_action(response, rest - plant.added.against_friction(x, v)) - unbounded_action(response, rest)


def first_pump_state() -> PumpState:
    """Nothing caught, pushing in the positive direction."""
    return PumpState(jnp.array(False), jnp.array(1.0))


def pumping_action(
    plant: Plant,
    pump: Pump,
    state: PumpState,
    x: Array,
    v: Array,
    target: Array,
    kp: float | Array,
    kd: float | Array,
    low: Array,
    high: Array,
) -> tuple[PumpState, Array]:
    """One step of pumping and catching.

    Args:
        plant: the model.
        pump: the plan.
        state: memory of the step before.
        x: `[n]` positions on the manifold.
        v: `[n]` velocities.
        target: `[n]` positions on the manifold.
        kp: stiffness, 1/s^2.
        kd: damping, 1/s.
        low: `[m]` lower bounds of the action; as `high` where a late actuator does what it was told before.
        high: `[m]` upper bounds.

    Returns:
        The memory, and the action that pumps. Once `caught`, use the control law instead.
    """
    moving, resting = responses(plant, x, v)

    def within(u: Array, share: float) -> Array:
        return jnp.all((u <= share * pump.high) & (u >= share * pump.low))

    holding = unbounded_action(resting, jnp.zeros_like(x))
    wanted = turning_acceleration(plant, x, v, target, kp, kd)
    catching = unbounded_action(moving, beyond_friction(plant, x, v, wanted))
    caught = jnp.where(state.caught, within(holding, RELEASE), within(catching, 1.0))

    apart = pump.curve - x
    distance = jnp.sum(jax.vmap(plant.momentum)(apart) * apart, axis=1)
    shape = turning_acceleration(plant, x, v, pump.curve[jnp.argmin(distance)], kp, kd, speed=jnp.inf)
    rate = plant.input_matrix(x)[:, pump.actuator] @ v
    fall = plant.input_matrix(x)[:, pump.actuator] @ resting.free
    start = jnp.where(jnp.abs(fall) > pump.level, jnp.sign(fall), state.direction)  # friction may hold it on a slope
    direction = jnp.where(jnp.abs(rate) > pump.slow, jnp.sign(rate), start)
    push = jnp.clip((pump.energy - energy(plant, x, v)) / (BAND * pump.span), -1.0, 1.0) * direction
    action = push * jnp.where(push > 0, high[pump.actuator], -low[pump.actuator])
    only = jnp.arange(len(low)) == pump.actuator
    along = moving.inputs @ jnp.linalg.solve(moving.gram, only.astype(x.dtype))  # a motion whose rate is one
    action = action + overcoming_friction(plant, moving, x, v + pump.slow * direction * along)[pump.actuator]
    action = jnp.clip(action, low[pump.actuator], high[pump.actuator])
    low, high = jnp.where(only, action, low), jnp.where(only, action, high)
    return PumpState(caught, direction), nearest_action(moving, beyond_friction(plant, x, v, shape), low, high)
