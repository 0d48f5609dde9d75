import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from oracle import SYSTEMS, make_oracle, point_masses, velocities

from keycld_control.observer import corrected, first_estimate, predicted
from keycld_control.plant import Plant
from keycld_control.trust import surprise
from keycld_envs import get_system
from keycld_model.physics import constraint

NOISE = 0.004


def track(name: str, steps: int = 40):
    """Estimates, true velocities and noisy keypoints of a motion in MuJoCo under changing actions."""
    rng = np.random.default_rng(0)
    system, plant = get_system(name), Plant.of(make_oracle(name))
    model = system.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-2, 2, model.nq)
    update = jax.jit(
        lambda estimate, action, x: corrected(plant, predicted(plant, estimate, action), x, plant.keypoint_noise)
    )
    estimates, truth, seen = [], [], []
    for step in range(steps):
        x = point_masses(name, data.qpos)
        seen.append(jnp.asarray(x + rng.normal(0, NOISE, len(x)), jnp.float32))
        action = data.ctrl.copy()
        estimates.append(update(estimates[-1], action, seen[-1]) if step else first_estimate(plant, seen[0]))
        truth.append(velocities(name, data.qpos, data.qvel))
        data.ctrl[:] = rng.uniform(-2, 2, model.nu)
        for _ in range(round(system.timestep / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return plant, estimates, np.array(truth), np.array(seen)


@pytest.mark.parametrize("name", SYSTEMS)
def test_velocities_are_neither_noisy_nor_late(name):
    plant, estimates, truth, seen = track(name)
    found = np.array([estimate.v for estimate in estimates])
    differences = np.gradient(seen, plant.timestep, axis=0)
    error, naive = (np.sqrt(np.mean((v - truth)[10:] ** 2)) for v in (found, differences))
    assert error < 0.5 * naive
    assert np.abs(truth).max() > 20 * error


@pytest.mark.parametrize("name", SYSTEMS)
def test_estimates_stay_on_the_manifold(name):
    plant, estimates, _, _ = track(name)
    for estimate in estimates:
        np.testing.assert_allclose(constraint(plant.mechanism, estimate.x, plant.pivot), plant.level, atol=1e-4)


def test_what_jumps_is_a_surprise_and_so_is_what_is_missing():
    plant, estimates, _, seen = track("acrobot", 20)
    prior = predicted(plant, estimates[-2], jnp.zeros(2))
    assert surprise(prior, jnp.asarray(seen[-1])) < 0.1
    assert surprise(prior, jnp.asarray(point_masses("acrobot", (0.3, 2.0)), jnp.float32)) > 0.25
    assert not surprise(prior, jnp.full(4, jnp.nan)) < 0.25
