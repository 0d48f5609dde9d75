"""The contract that every environment keeps."""

import pickle
import warnings
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RenderCollection

import keycld_envs
from keycld_envs import REFERENCE_SYSTEMS, SYSTEMS, KeyCLDEnv, get_system, resolve_env_id
from keycld_envs.collect import CollectSettings
from keycld_envs.registration import same_system


def rollout(env: gym.Env[Any, Any], seed: int, steps: int = 20) -> tuple[list[Any], list[float]]:
    env.action_space.seed(seed)
    observation, _ = env.reset(seed=seed)
    observations, rewards = [observation], []
    for _ in range(steps):
        observation, reward, *_ = env.step(env.action_space.sample())
        observations.append(observation)
        rewards.append(float(reward))
    return observations, rewards


@pytest.mark.render
@pytest.mark.parametrize(
    ("name", "obs_type"),
    [*((name, "pixels") for name in sorted(SYSTEMS)), ("acrobot", "state"), ("cartpole-stock", "pixels_state")],
)
def test_check_env_is_free_of_warnings(name: str, obs_type: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Gymnasium recommends actions within ±1, but the paper's range is ±3: that one remark is accepted
        warnings.filterwarnings("ignore", ".*we recommend using a symmetric and normalized space")
        env = gym.make(resolve_env_id(name), obs_type=obs_type, render_mode="rgb_array", width=16, height=16)
        check_env(env.unwrapped)
        env.close()


@pytest.mark.render
def test_check_env_has_nothing_to_remark_with_normalised_actions(domain: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(resolve_env_id(domain), action_limit=1, render_mode="rgb_array", width=16, height=16)
        check_env(env.unwrapped)
        env.close()


@pytest.mark.render
def test_observations_are_in_their_space_and_rewards_in_range(name: str) -> None:
    env = keycld_envs.make(name, obs_type="pixels_state", width=24, height=16)
    observations, rewards = rollout(env, seed=3)
    for observation in observations:
        assert env.observation_space.contains(observation)
        assert observation["pixels"].shape == (16, 24, 3)
    assert all(0 <= reward <= 1 for reward in rewards)
    assert np.ptp([observation["pixels"].astype(int) for observation in observations], axis=0).max() > 50
    env.close()


def test_default_observation_is_a_64_pixel_image(name: str) -> None:
    env = KeyCLDEnv(name)
    assert env.observation_space == gym.spaces.Box(0, 255, (64, 64, 3), np.uint8)


def test_state_observation_and_info(name: str) -> None:
    env = keycld_envs.make(name, obs_type="state")
    state, info = env.reset(seed=0)
    assert set(info) == {"qpos", "qvel", "energy", "is_success"}
    np.testing.assert_array_equal(state, np.concatenate([info["qpos"], info["qvel"]]))
    _, _, _, _, later = env.step(env.action_space.sample())
    assert not np.array_equal(info["qpos"], later["qpos"])  # copies, not views of the live data
    np.testing.assert_array_equal(later["qpos"], env.unwrapped.data.qpos)  # pyright: ignore


@pytest.mark.parametrize(
    ("env_id", "system"),
    [
        *[(f"KeyCLD/{s}-v0", s.lower()) for s in ("Pendulum", "Cartpole", "Acrobot")],
        *[(f"KeyCLD/{s}FullyActuated-v0", s.lower()) for s in ("Pendulum", "Cartpole", "Acrobot")],
        *[(f"KeyCLD/{s}Stock-v0", f"{s.lower()}-stock") for s in ("Pendulum", "Cartpole", "Acrobot")],
        ("keycld_envs:KeyCLD/Acrobot-v0", "acrobot"),
    ],
)
def test_ids(env_id: str, system: str) -> None:
    env = gym.make(env_id, obs_type="state")
    assert env.unwrapped.system is get_system(system)  # pyright: ignore
    assert env.spec is not None and env.spec.max_episode_steps == 1000
    assert resolve_env_id(env_id) == env_id.removeprefix("keycld_envs:")


def test_short_names() -> None:
    assert resolve_env_id("acrobot") == "KeyCLD/Acrobot-v0"
    assert resolve_env_id("acrobot-stock") == "KeyCLD/AcrobotStock-v0"
    assert resolve_env_id("Cartpole_Stock") == "KeyCLD/CartpoleStock-v0"


def test_episodes_are_truncated_never_terminated(name: str) -> None:
    env = keycld_envs.make(name, obs_type="state", max_episode_steps=7)
    env.reset(seed=0)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(7)]
    assert ends == [(False, False)] * 6 + [(False, True)]


def test_seeds_determine_everything(name: str) -> None:
    first, again, other = (rollout(KeyCLDEnv(name, obs_type="state"), seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1] == again[1]
    assert not np.array_equal(first[0][0], other[0][0])


def test_episodes_do_not_leak_into_each_other(name: str) -> None:
    env = KeyCLDEnv(name, obs_type="state")
    fresh = rollout(env, seed=1)
    rollout(env, seed=2, steps=50)
    again = rollout(env, seed=1)
    np.testing.assert_array_equal(fresh[0], again[0])


def test_random_starts(name: str) -> None:
    env = KeyCLDEnv(name, obs_type="state", start="random")
    infos = [env.reset(seed=0)[1]] + [env.reset()[1] for _ in range(199)]
    low, high = np.transpose([joint.start_range for joint in env.system.joints])
    fractions = (np.array([info["qpos"] for info in infos]) - low) / (high - low)
    assert (fractions >= 0).all() and (fractions <= 1).all()
    np.testing.assert_allclose(
        np.quantile(fractions, [0.1, 0.5, 0.9], axis=0).T, [[0.1, 0.5, 0.9]] * len(low), atol=0.1
    )
    assert all((info["qvel"] == 0).all() for info in infos)


def test_hanging_starts(name: str) -> None:
    env = KeyCLDEnv(name, obs_type="state", start="hanging")
    infos = [env.reset(seed=0)[1]] + [env.reset()[1] for _ in range(199)]
    for values in ([info["qpos"] - env.system.hanging_qpos for info in infos], [info["qvel"] for info in infos]):
        np.testing.assert_allclose(np.std(values, axis=0), 0.01, rtol=0.2)


def test_reset_options_set_the_state(name: str) -> None:
    env = KeyCLDEnv(name, obs_type="state")
    qpos, qvel = 0.1 * np.arange(1, env.model.nq + 1), 0.2 * np.arange(1, env.model.nv + 1)
    _, info = env.reset(seed=0, options={"qpos": qpos, "qvel": qvel})
    np.testing.assert_array_equal(info["qpos"], qpos)
    np.testing.assert_array_equal(info["qvel"], qvel)
    _, info = env.reset(options={"qpos": qpos.tolist()})
    np.testing.assert_array_equal(info["qvel"], 0)
    _, info = env.reset(options={"qvel": qvel})
    np.testing.assert_array_equal(info["qvel"], qvel)


def test_action_limit(name: str) -> None:
    system = get_system(name)
    default, wide = KeyCLDEnv(name, obs_type="state"), KeyCLDEnv(name, obs_type="state", action_limit=20)
    expected = system.action_limit or default.model.actuator_ctrlrange[0, 1]
    for env, limit in ((default, expected), (wide, 20)):
        assert env.action_space == gym.spaces.Box(-limit, limit, (system.mechanism.num_actions,), np.float32)
        at_limit, beyond = [], []
        for log, factor in ((at_limit, 1), (beyond, 3)):
            env.reset(options={"qpos": system.hanging_qpos})
            log.append(env.step(factor * env.action_space.high)[0])
        np.testing.assert_array_equal(at_limit, beyond)
        np.testing.assert_array_equal(env.data.ctrl, limit)


@pytest.mark.parametrize("name", [name for name in SYSTEMS if not get_system(name).compile().dof_damping.any()])
def test_energy_is_conserved_without_friction(name: str) -> None:
    """The paper's systems have no damping; with RK4 the drift over 2 s is tiny, with Euler at 0.02 s bounded."""
    env = KeyCLDEnv(name, obs_type="state")
    _, info = env.reset(seed=0)
    start, idle = info["energy"], np.zeros(env.model.nu)
    euler = env.model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    energies = [env.step(idle)[4]["energy"] for _ in range(round(2 / env.system.timestep))]
    np.testing.assert_allclose(energies, start, atol=0.3 if euler else 1e-3)


class Upright:
    """Drives a system's success criterion by setting the state directly."""

    def __init__(self, name: str) -> None:
        self.env = KeyCLDEnv(name, obs_type="state")
        self.env.model.opt.gravity[:] = 0  # stays where it is put
        self.env.model.dof_damping[:] = 0
        self.steps = round(1 / self.env.system.timestep)

    def after(self, steps: int, qpos: Any, qvel: Any = None) -> bool:
        options = {"qpos": qpos} | ({} if qvel is None else {"qvel": qvel})
        _, info = self.env.reset(options=options)
        assert not info["is_success"]
        idle = np.zeros(self.env.model.nu)
        return [self.env.step(idle)[4]["is_success"] for _ in range(steps)][-1]


def test_success_needs_one_second_at_the_target(name: str) -> None:
    upright = Upright(name)
    target = np.array(upright.env.system.target_qpos)
    assert upright.after(upright.steps, target)
    assert not upright.after(upright.steps - 1, target)
    assert upright.after(upright.steps, target + 2 * np.pi * np.eye(len(target))[-1])  # a whole turn further
    assert not upright.after(upright.steps, upright.env.system.hanging_qpos)


def test_success_window_starts_anew_after_an_interruption() -> None:
    upright = Upright("pendulum")
    assert upright.after(upright.steps + 3, [0.0])
    upright.env.data.qvel[:] = 0.6
    idle = np.zeros(1)
    assert not upright.env.step(idle)[4]["is_success"]
    upright.env.data.qvel[:] = 0
    results = [upright.env.step(idle)[4]["is_success"] for _ in range(upright.steps + 1)]
    assert results == [False] * upright.steps + [True]


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("pendulum", [0.19], [0.21]),
        ("cartpole", [0.09, 0.19], [0.11, 0.0]),
        ("cartpole", [-0.09, 0.0], [0.0, -0.21]),
        ("acrobot", [0.19, 0.0], [0.21, -0.21]),
        # the second link's angle counts absolutely, not against the first
        ("acrobot", [0.19, -0.38], [0.15, 0.15]),
    ],
)
def test_success_tolerances(name: str, inside: list[float], outside: list[float]) -> None:
    upright = Upright(name)
    assert upright.after(upright.steps, inside)
    assert not upright.after(upright.steps, outside)


def test_success_needs_slow_joints() -> None:
    pendulum = Upright("pendulum")
    assert pendulum.after(pendulum.steps, [-0.15], [0.3])
    assert not pendulum.after(pendulum.steps, [-0.15], [0.51])
    cartpole = Upright("cartpole")
    assert cartpole.after(cartpole.steps, [-0.05, 0.0], [0.09, 0.0])
    assert not cartpole.after(cartpole.steps, [0.0, -0.19], [0.0, 0.51])


@pytest.mark.render
def test_render_qpos_shows_a_configuration_and_leaves_the_state(domain: str) -> None:
    env = KeyCLDEnv(domain)
    observation, _ = env.reset(seed=4)
    state = env.data.qpos.copy(), env.data.qvel.copy(), env.data.time, env.data.xpos.copy()
    target = env.render_qpos(env.system.target_qpos)
    for before, now in zip(state, (env.data.qpos, env.data.qvel, env.data.time, env.data.xpos), strict=True):
        np.testing.assert_array_equal(before, now)
    np.testing.assert_array_equal(env.render_frame(), observation)
    assert np.abs(target.astype(int) - observation).max() > 50
    at_target, _ = env.reset(options={"qpos": env.system.target_qpos})
    np.testing.assert_array_equal(at_target, target)
    large = env.render_qpos(env.system.target_qpos, width=128, height=128)
    shrunk = large.reshape(64, 2, 64, 2, 3).mean((1, 3))
    assert large.shape == (128, 128, 3) and np.abs(shrunk - target).mean() < 3
    env.close()


@pytest.mark.render
def test_frames_for_people_are_of_their_own_size() -> None:
    env = KeyCLDEnv("acrobot", render_mode="rgb_array", width=16, height=24)
    observed, _ = env.reset(seed=0)
    frame = env.render()
    assert observed.shape == (24, 16, 3) and frame.shape == (480, 480, 3)
    np.testing.assert_array_equal(env.render_frame(), observed)
    np.testing.assert_array_equal(env.render_frame(width=480, height=480), frame)
    env.close()


@pytest.mark.render
def test_gymnasium_collects_frames_for_people() -> None:
    env = keycld_envs.make("pendulum", render_mode="rgb_array", obs_type="state", render_width=32, render_height=48)
    collected = RenderCollection(env)
    rollout(collected, seed=0, steps=3)
    frames = collected.render()
    assert np.array(frames).shape == (4, 48, 32, 3)
    collected.close()


@pytest.mark.render
def test_edits_of_the_live_model_show() -> None:
    env = KeyCLDEnv("pendulum")
    before, _ = env.reset(options={"qpos": [1.0]})
    env.model.mat_rgba[:] = [1, 0, 0, 1]
    assert np.abs(env.render_frame().astype(int) - before).max() > 50
    env.model.actuator_gear[:] = 0
    env.reset(options={"qpos": [1.0]})
    torque_free = env.step([3.0])[4]["qvel"]
    env.reset(options={"qpos": [1.0]})
    np.testing.assert_array_equal(env.step([0.0])[4]["qvel"], torque_free)
    env.close()


@pytest.mark.render
@pytest.mark.parametrize("name", ["acrobot", "cartpole-stock"])
def test_pickling_after_a_render(name: str) -> None:
    env = KeyCLDEnv(name, width=16, height=16, action_limit=2, start="hanging", render_quality="full", render_width=32)
    first, _ = env.reset(seed=0)
    copy = pickle.loads(pickle.dumps(env))
    second, _ = copy.reset(seed=0)
    np.testing.assert_array_equal(first, second)
    assert copy.action_space == env.action_space and copy.render_quality == "full" and copy.start == "hanging"
    assert (copy.render_width, copy.render_height) == (32, 480)
    env.close()
    copy.close()


@pytest.mark.render
def test_an_environment_renders_again_after_close() -> None:
    env = KeyCLDEnv("acrobot", width=16, height=16)
    first, _ = env.reset(seed=0)
    env.close()
    env.close()
    again, _ = env.reset(seed=0)
    np.testing.assert_array_equal(first, again)
    env.close()


@pytest.mark.render
def test_two_environments_render_side_by_side() -> None:
    one, two = (KeyCLDEnv(name, width=16, height=16) for name in ("acrobot", "pendulum"))
    alone = [env.reset(seed=0)[0] for env in (one, two)]
    mixed = [one.render_frame(), two.render_frame(), one.render_frame()]
    for image, expected in zip(mixed, [*alone, alone[0]], strict=True):
        np.testing.assert_array_equal(image, expected)
    one.close()
    np.testing.assert_array_equal(two.render_frame(), alone[1])
    two.close()


def test_systems_compile_to_what_they_declare(name: str) -> None:
    system = get_system(name)
    model = system.compile()
    assert system.name == name
    assert model.nu == system.mechanism.num_actions == len(system.actuators)
    assert len(system.landmarks) == system.mechanism.num_keypoints
    assert model.nv == system.mechanism.degrees_of_freedom
    assert system.weak_limit is None or 0 < system.weak_limit < KeyCLDEnv(name, obs_type="state").action_space.high[0]


def test_reference_systems_have_ids_of_their_own() -> None:
    assert set(REFERENCE_SYSTEMS) <= set(SYSTEMS)
    ids = [resolve_env_id(name) for name in SYSTEMS]
    assert len(set(ids)) == len(ids)
    for env_id, name in zip(ids, SYSTEMS, strict=True):
        assert keycld_envs.system_of(env_id) is get_system(name)


def test_ids_of_the_same_system() -> None:
    for one in ("acrobot", "KeyCLD/Acrobot-v0", "KeyCLD/AcrobotFullyActuated-v0", "keycld_envs:KeyCLD/Acrobot-v0"):
        assert same_system(one, "KeyCLD/Acrobot-v0") and not same_system(one, "KeyCLD/AcrobotStock-v0")
    assert same_system("their_module:Lab/Arm-v0", "Lab/Arm-v0") and not same_system("Lab/Arm-v0", "acrobot")
    assert CollectSettings("acrobot").env_id == "KeyCLD/Acrobot-v0"
