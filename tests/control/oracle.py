"""Exact world models of the reference systems: point masses that move as MuJoCo's bodies do.

Their images are not pictures: the first n pixels of the red channel hold the keypoints, to 8 bits, which makes an
error of 0.003 image units, as good encoders have.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from keycld_envs import KeyCLDEnv, get_system
from keycld_envs.mechanism import Mechanism

SHAPE = (8, 8)
RANGE = 1.25
GRAVITY = 9.81


@dataclass(frozen=True)
class Oracle:
    system: str | None
    mechanism: Mechanism
    masses: Array
    level: Array
    pivot: Array
    timestep: float
    image_shape: tuple[int, int]
    potential_energy_fn: Callable[[Array], Array]
    input_matrix_fn: Callable[[Array], Array]
    keypoints_fn: Callable[[Array], Array]
    render_fn: Callable[[Array], Array]
    constrained: bool = True
    added: Any = None


class OracleEnv(KeyCLDEnv):
    """The environment as the oracle sees it."""

    def _observation(self) -> Any:
        return self.render_qpos(self.data.qpos)

    def render_qpos(self, qpos: Any, **_: Any) -> Any:
        return image_of(point_masses(self.system.name, qpos))


@dataclass(frozen=True)
class Body:
    """Point masses of one system: `lengths` of its rods in metres, `weights` so that V = g sum(weights * height)."""

    masses: np.ndarray
    lengths: np.ndarray
    weights: np.ndarray
    gear: np.ndarray
    unit: float


def make_oracle(name: str, scale: float = 1.0, normal: float = 0.0) -> Oracle:
    """`scale` multiplies (M, V, g), `normal` adds components to grad V and g that no motion can feel."""
    system, body = get_system(name), body_of(name)
    mechanism, size = system.mechanism, 2 * system.mechanism.num_keypoints
    factor = scale / body.masses.sum()
    weights = jnp.asarray(factor * body.unit * GRAVITY * body.weights)
    gear = jnp.asarray(factor * body.unit**2 * body.gear)
    level = np.concatenate([(body.unit * body.lengths) ** 2 / 2, np.zeros(len(mechanism.sliders))])

    def last_rod(x: Array) -> Array:
        return x[-2:] - (x[-4:-2] if size > 2 else 0.0)

    def potential(x: Array) -> Array:
        extra = normal * jnp.sum(last_rod(x) ** 2) / 2
        return jnp.dot(weights, x.reshape(-1, 2)[:, 1]) + extra

    def inputs(x: Array) -> Array:
        rod = last_rod(x)
        extra = normal * (rod if size == 2 else jnp.concatenate([-rod, rod]))
        return _INPUTS[name](x, body.unit) * gear + extra[:, None]

    def keypoints(image: Array) -> Array:
        red = image.reshape(-1, 3)[:size, 0]
        red = red.astype(jnp.float32) / 255 if image.dtype == jnp.uint8 else red
        return (2 * red - 1) * RANGE

    def render(x: Array) -> Array:
        pixels = jnp.zeros((SHAPE[0] * SHAPE[1], 3)).at[:size, 0].set((x / RANGE + 1) / 2)
        return pixels.reshape(*SHAPE, 3)

    return Oracle(
        system=name,
        mechanism=mechanism,
        masses=jnp.asarray(scale * body.masses / body.masses.sum()),
        level=jnp.asarray(level),
        pivot=jnp.zeros(2),
        timestep=system.timestep,
        image_shape=SHAPE,
        potential_energy_fn=potential,
        input_matrix_fn=inputs,
        keypoints_fn=keypoints,
        render_fn=render,
    )


def image_of(x: np.ndarray) -> np.ndarray:
    """The oracle's image [8, 8, 3] uint8 of keypoints [n]."""
    image = np.zeros((SHAPE[0] * SHAPE[1], 3), np.uint8)
    image[: len(x), 0] = np.clip(np.round((x / RANGE + 1) / 2 * 255), 0, 255)
    return image.reshape(*SHAPE, 3)


def point_masses(name: str, qpos: Any) -> np.ndarray:
    """[n] positions of the point masses, image units."""
    body = body_of(name)

    def rod(index: int, angle: float) -> np.ndarray:
        return body.unit * body.lengths[index] * np.array([np.sin(angle), np.cos(angle)])

    if name == "pendulum":
        return rod(0, qpos[0])
    if name == "cartpole":
        cart = np.array([body.unit * qpos[0], 0.0])
        return np.concatenate([cart, cart + rod(0, qpos[1])])
    elbow = rod(0, qpos[0])
    return np.concatenate([elbow, elbow + rod(1, qpos[0] + qpos[1])])


def velocities(name: str, qpos: Any, qvel: Any) -> np.ndarray:
    """[n] velocities of the point masses, image units per second."""
    step = 1e-6 * np.asarray(qvel)
    return (point_masses(name, qpos + step) - point_masses(name, qpos - step)) / 2e-6


@cache
def body_of(name: str) -> Body:
    """Masses that have the inertia of the bodies about their joints, and weights that have their moments."""
    model = get_system(name).compile()
    metres = {"pendulum": 2.5, "cartpole": 6.0, "acrobot": 6.0}[name]
    masses, lengths, weights = _BODIES[name](model)
    unit = 64 / 63 / (metres * np.tan(np.pi / 8))
    return Body(np.array(masses), np.array(lengths), np.array(weights), model.actuator_gear[:, 0], unit)


def _link(model: mujoco.MjModel, name: str) -> tuple[float, float, float]:
    """Mass, first moment and inertia of a body about its joint."""
    body = model.body(name).id
    mass, arm = model.body_mass[body], model.body_ipos[body][2]
    return mass, mass * arm, model.body_inertia[body][1] + mass * arm**2


def _pendulum(model: mujoco.MjModel) -> tuple[list[float], ...]:
    _, moment, inertia = _link(model, "pole")
    return [inertia / 0.5**2], [0.5], [moment / 0.5]


def _cartpole(model: mujoco.MjModel) -> tuple[list[float], ...]:
    mass, moment, inertia = _link(model, "pole_1")
    length, cart = inertia / moment, model.body_mass[model.body("cart").id]
    tip = moment / length
    return [cart + mass - tip, tip], [length], [-tip, tip]


def _acrobot(model: mujoco.MjModel) -> tuple[list[float], ...]:
    (_, upper_moment, upper_inertia), (mass, moment, inertia) = _link(model, "upper_arm"), _link(model, "lower_arm")
    length = inertia / moment
    tip = moment / length
    return [upper_inertia + mass - tip, tip], [1.0, length], [upper_moment + mass - tip, tip]


def _torque(rod: Array) -> Array:
    """Force on a rod's end that makes a unit torque about its start, positive about MuJoCo's y axis (clockwise)."""
    return jnp.stack([rod[1], -rod[0]]) / jnp.sum(rod**2)


def _cartpole_inputs(x: Array, unit: float) -> Array:
    torque = _torque(x[2:] - x[:2])
    push = jnp.array([1 / unit, 0.0, 0.0, 0.0])
    return jnp.stack([push, jnp.concatenate([-torque, torque])], 1)


def _acrobot_inputs(x: Array, unit: float) -> Array:
    shoulder, elbow = _torque(x[:2]), _torque(x[2:] - x[:2])
    return jnp.stack([jnp.concatenate([shoulder, jnp.zeros(2)]), jnp.concatenate([-elbow - shoulder, elbow])], 1)


_BODIES = {"pendulum": _pendulum, "cartpole": _cartpole, "acrobot": _acrobot}
_INPUTS = {"pendulum": lambda x, unit: _torque(x)[:, None], "cartpole": _cartpole_inputs, "acrobot": _acrobot_inputs}
SYSTEMS = tuple(_BODIES)
"""Those whose point masses are known here in closed form."""
