"""Effects in the environments."""

import pickle

import gymnasium as gym
import numpy as np
import pytest

import keycld_envs  # noqa: F401
from keycld_envs.effects import ActuatorDelay, ActuatorGain, ClockDrift, ConstantForce, CoulombFriction, ViscousFriction
from keycld_envs.errors import InputError


def run(env, actions, qpos):
    env.reset(seed=0, options={"qpos": qpos})
    return np.array([env.step(action)[4]["qpos"] for action in actions])


def make(system, *effects, **keywords):
    return gym.make(f"KeyCLD/{system}-v0", obs_type="state", effects=effects, **keywords).unwrapped


def test_friction_makes_the_pendulum_lose_energy():
    still = np.zeros((200, 1))
    free, braked = (make("Pendulum", *effects) for effects in ((), (ViscousFriction("hinge", b=0.2),)))
    run(free, still, [1.5])
    run(braked, still, [1.5])
    energy = [env.get_wrapper_attr("data").energy.sum() for env in (free, braked)]
    assert energy[1] < energy[0] - 0.5


def test_dry_friction_holds():
    path = run(make("Acrobot", CoulombFriction("shoulder", c=50.0)), np.zeros((50, 2)), [1.0, 0.0])
    assert abs(path[-1, 0] - 1.0) < 0.05 < abs(path[-1, 1])


def test_a_delay_shifts_what_motors_do():
    actions = np.ones((20, 2)) * 0.5
    late = run(make("Cartpole", ActuatorDelay("slide", d=0.05)), actions * [1, 0], [0.0, np.pi])
    prompt = run(make("Cartpole"), actions * [1, 0], [0.0, np.pi])
    np.testing.assert_allclose(late[5:], prompt[:-5], atol=1e-6)
    np.testing.assert_allclose(late[:5], [[0.0, np.pi]] * 5, atol=1e-6)


def test_a_gain_is_a_larger_action_and_a_force_a_constant_one():
    strong = run(make("Pendulum", ActuatorGain("torque", k=2.0)), np.ones((30, 1)) * 0.7, [0.5])
    np.testing.assert_allclose(strong, run(make("Pendulum"), np.ones((30, 1)) * 1.4, [0.5]), atol=1e-9)
    pushed = run(make("Pendulum", ConstantForce("hinge", f=2.0)), np.zeros((30, 1)), [0.5])
    np.testing.assert_allclose(pushed, run(make("Pendulum"), np.ones((30, 1)), [0.5]), atol=1e-9)  # gear 2


def test_environments_with_effects_travel_and_repeat():
    env = make("Acrobot", ActuatorDelay("elbow", d=0.02), CoulombFriction("elbow", c=0.1))
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 2))
    first = run(env, actions, [1.0, 0.5])
    np.testing.assert_array_equal(first, run(env, actions, [1.0, 0.5]))
    np.testing.assert_array_equal(first, run(pickle.loads(pickle.dumps(env)), actions, [1.0, 0.5]))


@pytest.mark.parametrize(
    "effect, message",
    [
        (CoulombFriction("knee", c=0.1), "coulomb_friction is at 'knee'.*'elbow', 'shoulder'"),
        (ClockDrift(epsilon=0.1), "clock_drift is in the measurement"),
        ("friction", "must hold effects"),
        (ViscousFriction("elbow", b=-5.0), "b=-5 .*must be 0 or more"),
        (ViscousFriction("elbow", b=np.nan), "b=nan; it must be a finite number"),
        (ActuatorDelay("elbow", d=1e9), r"d=1e\+09 s; it must be between 0 and 2"),
    ],
)
def test_effects_that_cannot_be_are_refused(effect, message):
    with pytest.raises(InputError, match=message):
        make("Acrobot", effect)
