from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from oracle import OracleEnv, image_of, make_oracle, point_masses

from keycld_control import closed_loop
from keycld_control.agent import EnergyShapingAgent
from keycld_control.cli import main
from keycld_control.closed_loop import Episode, Loop, LoopSettings, run_episode
from keycld_control.swingup import summarise, swing_up
from keycld_envs import InputError

SEED = 10_000


@pytest.mark.parametrize(
    ("name", "start", "limit", "pumps"),
    [
        ("pendulum", "hanging", None, False),
        pytest.param("pendulum", "hanging", 1.0, True, marks=pytest.mark.slow),
        ("cartpole", "random", None, False),
        ("cartpole", "hanging", None, False),
        ("acrobot", "random", None, False),
        ("acrobot", "hanging", None, False),
        pytest.param("acrobot", "hanging", 3.0, True, marks=pytest.mark.slow),
    ],
)
def test_exact_models_swing_up(name, start, limit, pumps):
    env = OracleEnv(name, start=start, action_limit=limit)
    target = image_of(point_masses(name, env.system.target_qpos))
    agent = EnergyShapingAgent(make_oracle(name), target, action_space=env.action_space)
    assert agent.pumps == pumps
    episode = run_episode(Loop(env, "test", 1000, agent), SEED)
    assert episode.success
    assert episode.upright_s < 8


@pytest.fixture
def oracle_settings(monkeypatch) -> LoopSettings:
    """An environment and a model that go through the whole library without rendering."""
    env_id = "KeyCLDTest/OraclePendulum-v0"
    if env_id not in gym.registry:
        gym.register(
            env_id,
            entry_point=lambda **options: OracleEnv(**options),
            max_episode_steps=120,
            kwargs={"system": "pendulum"},
        )

    class Shipped:
        @staticmethod
        def load(name: str):
            return make_oracle(name)

    monkeypatch.setattr(closed_loop, "WorldModel", Shipped)
    return LoopSettings(env_id, weights="pendulum", start="hanging", seed=SEED)


def test_swing_up_counts(oracle_settings):
    result = swing_up(oracle_settings, episodes=3)
    assert replace(swing_up(oracle_settings, episodes=3), act_per_second=result.act_per_second) == result
    assert (result.successes, result.episodes, result.start, result.weights) == (3, 3, "hanging", "pendulum")
    assert 0 < result.median_time_to_upright_s < 1.4
    assert result.act_per_second > 300


def test_weights_of_another_system_are_refused(oracle_settings):
    with pytest.raises(InputError, match=r"trained on cartpole, not on KeyCLDTest/OraclePendulum-v0"):
        swing_up(replace(oracle_settings, weights="cartpole"), episodes=1)


def test_statistics():
    done = [
        Episode(True, 1.0, 900.0, 100, 0.1),
        Episode(False, np.inf, 100.0, 100, 0.3),
        Episode(True, 2.0, 800.0, 0, 0),
    ]
    result = summarise(done, "KeyCLD/Pendulum-v0", "random", LoopSettings("pendulum", seed=5))
    assert result.successes == 2
    assert result.interval == (0.0943, 0.9916)  # Clopper and Pearson's, 2 of 3
    assert (result.median_time_to_upright_s, result.mean_return, result.act_per_second) == (2.0, 600.0, 500.0)
    assert (result.seed, result.weights) == (5, "pendulum")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["acrobat"], "did you mean"),
        (["acrobot", "--episodes", "0"], "at least 1"),
        (["acrobot", "--seed", "-1"], "seed is -1"),
        (["acrobot", "--video", "clip.avi"], ".mp4 or .gif"),
        (["acrobot", "--weights", "no/such/checkpoint"], "no/such/checkpoint"),
    ],
)
def test_bad_arguments_end_in_one_sentence(arguments, reason, capsys):
    assert main(["swingup", *arguments]) == 2
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1
