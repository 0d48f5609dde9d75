"""A mechanism of one's own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import keycld_envs
from keycld_envs import InputError, Joint, KeyCLDEnv, Landmark, System


@pytest.mark.render
def test_a_system_of_ones_own(slider: System, tmp_path: Path) -> None:
    path = tmp_path / "slider.xml"
    path.write_text(str(slider.mjcf))
    env = KeyCLDEnv(replace(slider, mjcf=path))
    image, info = env.reset(options={"qpos": [0.3]})
    x, y = env.keypoints()[0]
    column, row = round((x + 1) / 2 * 63), round((1 - y) / 2 * 63)
    assert image[row, column].min() > 50 and image[row, 63 - column].max() < 10  # the cart, and nothing opposite
    for _ in range(5):
        _, _, _, _, info = env.step([2.0])
    assert info["qvel"] == pytest.approx(5 * 0.02 * 2 / 2)  # 0.1 s at 1 m/s², in 20 steps of the MJCF
    assert env.metadata["render_fps"] == 50
    env.close()


def test_without_a_reward_it_is_one_at_the_target(slider: System) -> None:
    env = KeyCLDEnv(slider, obs_type="state")
    env.reset(options={"qpos": [0.05]})
    assert env.step([0.0])[1] == 1
    env.reset(options={"qpos": [0.15]})
    assert env.step([0.0])[1] == 0
    assert env.action_space == gym.spaces.Box(-2, 2, (1,), np.float32)  # the MJCF's own range


def test_register(slider: System) -> None:
    keycld_envs.register(slider, "Test/Slider-v0", max_episode_steps=5)
    try:
        env = gym.make("Test/Slider-v0", obs_type="state")
        assert env.reset(seed=0)[0].shape == (2,)
        assert env.spec is not None and env.spec.max_episode_steps == 5
        assert keycld_envs.resolve_env_id("slider") == "Test/Slider-v0"
    finally:
        del gym.registry["Test/Slider-v0"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mjcf": "<mujoco><nonsense/></mujoco>"}, "does not compile"),
        ({"mjcf": Path("nowhere.xml")}, "does not compile"),
        ({"mjcf": "a note\non two lines"}, "is no XML"),
        ({"joints": (Joint("rail", "hinge", (0, 1)),)}, "declares the joints"),
        ({"actuators": ("pull",)}, "declares the actuators"),
        ({"landmarks": ()}, "declares 0 keypoints"),
        ({"landmarks": (Landmark("wagon"),)}, "no body named 'wagon'"),
        ({"target_qpos": (0.0, 0.0)}, "target_qpos and hanging_qpos of length 1"),
        ({"camera": "side"}, "no camera 'side'"),
        ({"timestep": 0.012}, "no whole multiple"),
    ],
)
def test_a_declaration_that_does_not_fit(slider: System, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        KeyCLDEnv(replace(slider, **change))
    assert "\n" not in str(caught.value)
