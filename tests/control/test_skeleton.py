import jax.numpy as jnp
import numpy as np
import pytest
from oracle import SYSTEMS, make_oracle, point_masses

from keycld_control.skeleton import assemble, rod_vectors, root_keypoints, turned, turning_error
from keycld_envs import Mechanism, Rod, get_system

BRANCHED = Mechanism(4, 3, rods=(Rod(None, 0), Rod(0, 1), Rod(0, 2), Rod(2, 3)), pivot=(0.2, -0.1))


@pytest.mark.parametrize("mechanism", [BRANCHED, *(get_system(name).mechanism for name in SYSTEMS)])
def test_rods_add_up_to_positions(mechanism):
    pivot = jnp.asarray(mechanism.pivot)
    x = jnp.asarray(np.random.default_rng(0).normal(size=2 * mechanism.num_keypoints), jnp.float32)
    origin = jnp.tile(pivot, mechanism.num_keypoints)
    roots = (x - origin).reshape(-1, 2)[root_keypoints(mechanism)]
    np.testing.assert_allclose(assemble(mechanism, rod_vectors(mechanism, x, pivot), roots) + origin, x, atol=1e-6)


def test_turning_every_rod_once_round_changes_nothing():
    x = jnp.asarray(np.random.default_rng(1).normal(size=8), jnp.float32)
    pivot = jnp.asarray(BRANCHED.pivot)
    np.testing.assert_allclose(turned(BRANCHED, x, jnp.full(4, 2 * np.pi), pivot), x, atol=1e-5)
    half = turned(BRANCHED, x, jnp.full(4, np.pi), pivot)
    np.testing.assert_allclose(half, 2 * jnp.tile(pivot, 4) - x, atol=1e-5)


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_turning_error_is_the_joint_error_times_the_jacobian(name):
    mechanism, qpos, step = make_oracle(name).mechanism, np.array([2.8, -1.3]), 1e-4
    target = jnp.asarray(point_masses(name, (0.0, 0.0)), jnp.float32)
    found = turning_error(mechanism, jnp.asarray(point_masses(name, qpos), jnp.float32), target, jnp.zeros(2))
    ahead, behind = (point_masses(name, (1 + s) * qpos) for s in (step, -step))
    np.testing.assert_allclose(found, (ahead - behind) / (2 * step), atol=1e-4)
    near = jnp.asarray(point_masses(name, 1e-3 * qpos), jnp.float32)
    np.testing.assert_allclose(turning_error(mechanism, near, target, jnp.zeros(2)), near - target, atol=1e-5)
