from dataclasses import replace

import gymnasium as gym
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from oracle import RANGE, SHAPE, SYSTEMS, image_of, make_oracle, point_masses

from keycld_control import EnergyShapingAgent
from keycld_control.agent import _keypoint_noise
from keycld_control.plant import KEYPOINT_NOISE
from keycld_envs import InputError, Mechanism, get_system

UPRIGHT = (0.0, 0.0)


def make_agent(name: str, **options) -> EnergyShapingAgent:
    return EnergyShapingAgent(make_oracle(name), image_of(point_masses(name, UPRIGHT)), **options)


def images(name: str, seed: int = 0, length: int = 5, scale: float = 1.0) -> list[np.ndarray]:
    """A motion from a random configuration; a small scale keeps it near the target, where no bound binds."""
    rng = np.random.default_rng(seed)
    start, speed = scale * rng.uniform(-3, 3, (2, len(get_system(name).joints)))
    return [image_of(point_masses(name, start + 0.01 * i * speed)) for i in range(length)]


@pytest.fixture(scope="module")
def agents() -> dict[str, EnergyShapingAgent]:
    return {name: make_agent(name) for name in SYSTEMS}


@pytest.mark.parametrize("name", SYSTEMS)
def test_actions_fit_the_action_space(agents, name):
    space = gym.make(f"keycld_envs:KeyCLD/{name.capitalize()}-v0", disable_env_checker=True).action_space
    for seed in range(5):
        agents[name].reset()
        for image in images(name, seed):
            assert agents[name].act(image) in space


@pytest.mark.parametrize("name", SYSTEMS)
def test_reset_forgets_everything(agents, name):
    agent, forth = agents[name], images(name, scale=0.1)
    agent.reset()
    first = [agent.act(image) for image in forth]
    continued = [agent.act(image) for image in forth[::-1]]
    agent.reset()
    np.testing.assert_array_equal(first, [agent.act(image) for image in forth])
    agent.reset()
    assert not np.array_equal(continued, [agent.act(image) for image in forth[::-1]])


def test_observations_may_be_mappings_or_floats(agents):
    agent, image = agents["acrobot"], images("acrobot")[0]
    actions = []
    for observation in (image, {"pixels": image, "state": None}, image / 255, (image / 255).astype(np.float32)):
        agent.reset()
        actions.append(agent.act(observation))
    np.testing.assert_allclose(actions, [actions[0]] * 4, atol=1e-3)


def test_estimates_are_available(agents):
    agent, expected = agents["acrobot"], point_masses("acrobot", (0.4, -0.9))
    agent.reset()
    agent.act(image_of(expected))
    np.testing.assert_allclose(agent.keypoints, expected.reshape(2, 2), atol=RANGE / 128)
    assert agent.velocities.shape == (2, 2)
    assert agent.energy < agent.target_energy


@pytest.mark.parametrize(
    ("observation", "reason"),
    [
        (np.zeros((9, 8, 3), np.uint8), "shape"),
        (np.zeros((1, 8, 8, 3), np.uint8), "shape"),
        (np.zeros((*SHAPE, 3), np.int64), "int64"),
        (np.full((*SHAPE, 3), np.nan), "NaN"),
        (np.full((*SHAPE, 3), 200.0), "outside 0 to 1"),
        ({"state": np.zeros(2)}, "'pixels'"),
    ],
)
def test_bad_observations_are_refused(agents, observation, reason):
    with pytest.raises(InputError, match=reason):
        agents["pendulum"].act(observation)


def test_no_estimate_before_the_first_image(agents):
    agents["pendulum"].reset()
    with pytest.raises(InputError, match="call act first"):
        _ = agents["pendulum"].keypoints


@pytest.mark.parametrize(
    ("keypoints", "reason"),
    [
        ([0.0, 0.6, 0.0, 0.9], r"rod from the pivot to keypoint 0 is 0\.6"),
        ([0.0, 0.41, 0.0, 1.0], r"rod from keypoint 0 to keypoint 1 is 0\.5"),
    ],
)
def test_impossible_targets_are_refused(keypoints, reason):
    with pytest.raises(InputError, match=reason):
        EnergyShapingAgent(make_oracle("acrobot"), image_of(np.array(keypoints)))


def test_targets_off_the_rail_are_refused():
    with pytest.raises(InputError, match="off its rail"):
        EnergyShapingAgent(make_oracle("cartpole"), image_of(np.array([0.0, 0.2, 0.0, 0.5])))


def test_targets_without_the_mechanism_are_refused():
    image = image_of(point_masses("acrobot", UPRIGHT))
    image[..., 1:] = 255
    with pytest.raises(InputError, match="not found in the target image"):
        EnergyShapingAgent(make_oracle("acrobot"), image)


def test_targets_of_another_size_are_refused():
    with pytest.raises(InputError, match=r"\(16, 16, 3\).*\(8, 8, 3\)"):
        EnergyShapingAgent(make_oracle("acrobot"), np.zeros((16, 16, 3), np.uint8))


def test_limits_may_be_given_in_three_ways():
    image = image_of(point_masses("pendulum", (2.0, 0.0)))
    limited = [
        make_agent("pendulum", action_limit=2.8),
        make_agent("pendulum", action_limit=[2.8]),
        make_agent("pendulum", action_space=spaces.Box(-2.8, 2.8, (1,))),
    ]
    actions = [agent.act(image) for agent in limited]
    assert np.abs(actions).max() == np.float32(2.8)
    np.testing.assert_array_equal(actions, [actions[0]] * 3)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"kp": 0.0}, "kp"),
        ({"kd": np.nan}, "kd"),
        ({"kp": "a"}, "kp must be a positive finite number, got 'a'"),
        ({"law": "pid"}, "'turning'"),
        ({"action_limit": -1.0}, "enclose zero"),
        ({"action_limit": np.nan}, "enclose zero"),
        ({"action_limit": [1.0, 1.0]}, "shape"),
        ({"action_space": spaces.Discrete(3)}, "Box"),
        ({"action_space": spaces.Box(-1, 1, (1,)), "action_limit": 1.0}, "exclude each other"),
    ],
)
def test_bad_options_are_refused(options, reason):
    with pytest.raises(InputError, match=reason):
        make_agent("pendulum", **options)


@pytest.mark.parametrize("system", [None, "somebody-elses-robot"])
def test_unknown_limits_have_to_be_given(system):
    oracle = make_oracle("pendulum")
    object.__setattr__(oracle, "system", system)
    target = image_of(point_masses("pendulum", UPRIGHT))
    with pytest.raises(InputError, match=r"action_space=env\.action_space"):
        EnergyShapingAgent(oracle, target)
    assert EnergyShapingAgent(oracle, target, action_limit=3.0).act(target).shape == (1,)


def test_underactuated_mechanisms_are_refused():
    oracle, full = make_oracle("acrobot"), make_oracle("acrobot").input_matrix_fn
    object.__setattr__(oracle, "mechanism", Mechanism(2, 1, rods=oracle.mechanism.rods))
    object.__setattr__(oracle, "input_matrix_fn", lambda x: full(x)[:, 1:])
    with pytest.raises(InputError, match=r"1 action\(s\) for 2 degree\(s\) of freedom"):
        EnergyShapingAgent(oracle, image_of(point_masses("acrobot", UPRIGHT)), action_limit=3.0)


@pytest.mark.parametrize("off, noise", [(0.0, KEYPOINT_NOISE), (0.005, KEYPOINT_NOISE), (0.03, 0.03)])
def test_keypoints_that_are_far_off_at_the_target_are_trusted_less(off, noise):
    """Where a part is hidden behind another, a rod may seem too long."""
    model = make_oracle("acrobot")
    image = image_of(point_masses("acrobot", UPRIGHT))
    target = model.keypoints_fn(jnp.asarray(image))
    seen = replace(model, keypoints_fn=lambda image: model.keypoints_fn(image) + off * jnp.array([0.0, 0, 0, 1]))
    assert _keypoint_noise(seen, image, target) == pytest.approx(noise, rel=1e-3)
