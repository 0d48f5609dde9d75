"""An estimator that reads nearly the sign of an angle: the loop swings, notices, and believes images less."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracle import OracleEnv, image_of, make_oracle, point_masses

from keycld_control.agent import EnergyShapingAgent
from keycld_control.closed_loop import Loop, run_episode
from keycld_control.law import turning_action
from keycld_control.limit_cycle import CALMER, MOST, MUCH, NEAR, NOISIER, SLOW, TIMES, Swinging, no_swinging, watched
from keycld_control.observer import Estimate, corrected, first_estimate, predicted
from keycld_control.plant import Plant, advanced
from keycld_envs.effects import ActuatorDelay

STEP, THIN = 0.08, 0.08
"""Radians by which an angle is read too large, and up to which it is about; as of a thin pole that stands upright."""


def pendulum():
    """Mechanics, and the upright target."""
    plant = Plant.of(make_oracle("pendulum"))
    return plant, jnp.asarray(point_masses("pendulum", np.zeros(1)), jnp.float32)


def read(target, x):
    """Keypoints as such an estimator finds them."""
    angle = jnp.arctan2(x[0], x[1])
    seen = angle + STEP * jnp.tanh(angle / 0.01) * jnp.exp(-((angle / THIN) ** 2))
    return jnp.linalg.norm(target) * jnp.stack([jnp.sin(seen), jnp.cos(seen)])


def fastest(noticing, seconds=8.0):
    """Fastest in the second and the last quarter of an episode, rad/s."""
    plant, target = pendulum()

    @jax.jit
    def step(state, _):
        x, v, estimate, swinging, action = state
        x, v = advanced(plant, x, v, action)
        prior = predicted(plant, estimate, action)
        estimate = corrected(plant, prior, read(target, x), swinging.noise(plant))
        swinging = watched(plant, target, swinging, estimate) if noticing else swinging
        bound = jnp.full(1, 10.0)
        kp, kd = swinging.gains(40.0, 10.0)
        action = turning_action(plant, estimate.x, estimate.v, target, kp, kd, -bound, bound)
        return (x, v, estimate, swinging, action), (jnp.linalg.norm(v) / jnp.linalg.norm(target), swinging.times)

    x = jnp.asarray(point_masses("pendulum", np.full(1, 0.05)), jnp.float32)
    first = x, jnp.zeros(2), first_estimate(plant, x), no_swinging(), jnp.zeros(1)
    count = round(seconds / plant.timestep)
    speeds, times = jax.lax.scan(step, first, length=count)[1]
    assert times[-1] == (TIMES if noticing else 0)
    return (float(jnp.abs(part).max()) for part in (speeds[count // 4 : count // 2], speeds[-count // 4 :]))


def test_swings_become_slower_when_images_are_believed_less():
    before, kept = fastest(noticing=False)
    begun, left = fastest(noticing=True)
    assert kept == pytest.approx(before, rel=0.05)  # it swings for ever
    assert left < 0.75 * kept
    assert left < 1.05 * begun


def followed(positions, speed, plant, target, frames):
    """What is thought after estimates at `positions` of a time in s, which move by `speed` image units per second."""
    look, swinging = jax.jit(partial(watched, plant, target)), no_swinging()
    for k in range(frames):
        t = k * plant.timestep
        estimate = Estimate(target + jnp.asarray([positions(t), 0.0]), jnp.asarray([speed(t), 0.0]), jnp.zeros(3))
        swinging = look(swinging, estimate)
    return swinging


def test_an_approach_is_no_swinging():
    plant, target = pendulum()
    coming = followed(lambda t: NEAR * np.exp(-5 * t), lambda t: -5 * NEAR * np.exp(-5 * t), plant, target, 100)
    past = followed(lambda t: 0.02 * t / 0.1, lambda t: 0.2, plant, target, 5)  # .1 s on the other side
    still = followed(lambda t: 0.02 * np.sin(12 * t), lambda t: SLOW * np.cos(12 * t), plant, target, 400)
    for each in (coming, past, still):
        assert each.times == 0
        assert each.share < MUCH


def test_swings_count_near_the_target_only_and_twice():
    plant, target = pendulum()
    swing, speed = (lambda t: 0.02 * np.sin(12 * t)), (lambda t: 0.24 * np.cos(12 * t))
    assert followed(swing, speed, plant, target, 30).times == 1
    swinging = followed(swing, speed, plant, target, 1000)
    assert swinging.times == TIMES
    far = Estimate(target + jnp.asarray([2 * NEAR, 0.0]), jnp.asarray([1.0, 0.0]), jnp.zeros(3))
    assert watched(plant, target, swinging, far).times == 0


def test_images_count_less_and_motion_is_damped_more():
    plant, _ = pendulum()
    none, once, twice = (Swinging(jnp.zeros(()), jnp.asarray(float(n))) for n in (0, 1, 2))
    assert none.noise(plant) == pytest.approx(plant.keypoint_noise)
    assert once.noise(plant) == pytest.approx(NOISIER * plant.keypoint_noise)
    blurred = replace(plant, keypoint_noise=0.03)
    assert twice.noise(blurred) == pytest.approx(MOST)
    assert twice.noise(replace(plant, keypoint_noise=2 * MOST)) == pytest.approx(2 * MOST)
    np.testing.assert_allclose(none.gains(40.0, 10.0), (40.0, 10.0))
    np.testing.assert_allclose(twice.gains(40.0, 10.0), (40.0 / CALMER**2, 10.0 * CALMER**2), rtol=1e-5)


@pytest.mark.slow
def test_an_agent_calms_a_mechanism_whose_motors_are_later_than_it_knows():
    env = OracleEnv("acrobot", effects=[ActuatorDelay("shoulder", 0.05), ActuatorDelay("elbow", 0.05)])
    target = image_of(point_masses("acrobot", env.system.target_qpos))
    agent = EnergyShapingAgent(make_oracle("acrobot"), target, action_space=env.action_space)
    assert run_episode(Loop(env, "test", 600, agent), 20_000).success
    assert agent._known.swinging.times > 0
