"""The learned Lagrangian in motion: energy, drift, order; states estimated from keypoints and pixels."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from keycld_envs import get_system
from keycld_model import physics
from keycld_model.lagrangian import Lagrangian
from keycld_model.nets.hourglass import grid
from keycld_model.state_estimation import KEYPOINT_WEIGHT, estimate_state, refine_state

pytestmark = pytest.mark.usefixtures("unoptimised", "x64")

NAMES = ("pendulum", "cartpole", "acrobot")
"""Mechanisms that the tolerances below are for."""
LENGTH = 0.4


def make(name, seed=0):
    """Random V and g of about the strength of gravity, unequal masses, rods of 0.4 image units."""
    mechanism = get_system(name).mechanism
    dynamics = Lagrangian(mechanism, 16, 10.0, 0.5, False, nnx.Rngs(seed))
    dynamics.log_masses[...] = 0.5 * jnp.arange(mechanism.num_keypoints)
    dynamics.level[...] = jnp.array([LENGTH**2 / 2] * len(mechanism.rods) + [0.0] * len(mechanism.sliders))
    return dynamics


def start(dynamics, seed=1, speed=2.0):
    x, v = np.random.default_rng(seed).normal(size=(2, 2 * dynamics.mechanism.num_keypoints))
    return dynamics.project(jnp.asarray(x), jnp.asarray(speed * v), iterations=20)


@partial(jax.jit, static_argnums=0)
def rollout(dynamics, x, v, u, timestep):
    return dynamics.rollout(x, v, u, timestep)


def energies(dynamics, xs, vs):
    kinetic = jax.vmap(partial(physics.kinetic_energy, dynamics.held, dynamics.masses))(vs)
    return np.asarray(kinetic + jax.vmap(dynamics.potential_energy)(xs))


@pytest.mark.parametrize("name", NAMES)
def test_energy_is_conserved_and_rods_keep_their_length(name):
    dynamics = make(name)
    x, v = start(dynamics)
    changes, u = [], jnp.zeros((200, dynamics.mechanism.num_actions))
    jacobians = jax.jit(jax.vmap(partial(physics.constraint_jacobian, dynamics.mechanism)))
    for steps in (50, 200):  # in one second
        xs, vs = rollout(dynamics, x, v, u, 1 / steps)
        xs, vs = xs[: steps + 1], vs[: steps + 1]
        energy = energies(dynamics, xs, vs)
        assert np.ptp(xs, axis=0).max() > 0.1
        changes.append(np.abs(energy - energy[0]).max() / np.ptp(jax.vmap(dynamics.potential_energy)(xs)))
        drift = jax.vmap(dynamics.constraint)(xs) - dynamics.level[...][None]
        assert np.abs(drift).max() < 1e-7
        assert np.abs(jnp.einsum("tcn,tn->tc", jacobians(xs), vs)).max() < 1e-5
    assert changes[0] < 2e-2
    assert changes[1] < changes[0] / 20  # the kinks of CELU's second derivative keep it from full fourth order


@pytest.mark.parametrize("name", NAMES)
def test_work_of_the_actions_is_the_change_of_energy(name):
    """dE/dt = v' g(x) u: constraint forces and curvature do no work."""
    dynamics = make(name)
    x, v = start(dynamics)
    u = jnp.arange(1.0, dynamics.mechanism.num_actions + 1)
    a = dynamics.acceleration(x, v, u)

    def energy(t):
        return physics.kinetic_energy(dynamics.held, dynamics.masses, v + t * a) + dynamics.potential_energy(x + t * v)

    power = v @ dynamics.input_matrix(x) @ u
    np.testing.assert_allclose(jax.grad(energy)(0.0), power, rtol=1e-4, atol=1e-4)
    assert abs(power) > 1e-2


def test_masses_are_positive_fractions():
    dynamics = make("acrobot")
    np.testing.assert_allclose(np.sum(dynamics.masses), 1)
    assert (np.asarray(dynamics.masses) > 0).all()
    dynamics.log_masses[...] += 3.0  # their common scale has no meaning
    np.testing.assert_allclose(dynamics.masses, make("acrobot").masses, rtol=1e-6)


def test_rollout_of_no_actions_is_the_projected_state():
    dynamics = make("acrobot")
    x, v = start(dynamics)
    xs, vs = dynamics.rollout(x + 0.01, v, jnp.zeros((0, 2)), 0.01)
    expected = dynamics.project(x + 0.01, v)
    np.testing.assert_allclose(xs, expected[0][None])
    np.testing.assert_allclose(vs, expected[1][None])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cartpole", "acrobot"])
def test_keypoints_give_the_state_and_noise_averages_out(name):
    dynamics, h, sigma = make(name), 0.02, 1e-3
    x, v = start(dynamics, speed=4.0)
    u = jnp.asarray(np.random.default_rng(5).uniform(-3, 3, (14, dynamics.mechanism.num_actions)))
    xs, vs = rollout(dynamics, x, v, u, h)
    fit = jax.jit(partial(estimate_state, dynamics, timestep=h))
    found = fit(xs, u)
    np.testing.assert_allclose(found[0], xs[0], atol=1e-6)
    np.testing.assert_allclose(found[1], vs[0], atol=1e-5)
    assert np.abs((xs[1] - xs[0]) / h - vs[0]).max() > 1e-2  # a difference of two frames is off by far more

    rng = np.random.default_rng(0)
    errors = [np.asarray(fit(xs + sigma * rng.normal(size=xs.shape), u)[1] - vs[0]) for _ in range(20)]
    assert np.sqrt(np.mean(np.square(errors))) < 0.25 * sigma * np.sqrt(2) / h


def blobs(xs, size=16):
    """Frames [T, H, W, 3] with a smooth spot at each keypoint."""
    points = xs.reshape(xs.shape[0], -1, 1, 1, 2)
    squared = jnp.sum((grid(size, size, 1)[None, None] - points) ** 2, -1)
    image = jnp.sum(jnp.exp(-squared / 0.05), 1)
    return jnp.repeat(image[..., None], 3, axis=-1)


@pytest.mark.long
def test_refinement_gives_the_true_state_and_never_a_worse_one():
    dynamics, h = make("acrobot"), 0.02
    x, v = start(dynamics)
    u = jnp.ones((4, 2))
    xs, vs = dynamics.rollout(x, v, u, h, fine=True)
    frames = blobs(xs)

    @jax.jit
    def error(x, v):
        positions = dynamics.rollout(x, v, u, h, fine=True)[0]
        return jnp.sum((blobs(positions) - frames) ** 2) + jnp.sum((KEYPOINT_WEIGHT * (positions - xs)) ** 2)

    refine = jax.jit(lambda x, v: refine_state(dynamics, blobs, frames, xs, u, h, (x, v)))
    near = dynamics.project(x + 0.02, v + 0.3)
    found = refine(*near)
    np.testing.assert_allclose(found[0], xs[0], atol=1e-3)
    np.testing.assert_allclose(found[1], vs[0], atol=2e-2)

    rng, kept = np.random.default_rng(0), 0
    for distance in np.linspace(0.05, 3, 20):
        guess = dynamics.project(x + distance * rng.normal(size=4), v + 40 * distance * rng.normal(size=4), 20)
        new = refine(*guess)
        assert error(*new) <= error(*guess) * (1 + 1e-9)
        kept += bool(np.allclose(new[0], guess[0], atol=1e-12))
    assert kept > 0  # some steps were refused, so the comparison above has been at work
