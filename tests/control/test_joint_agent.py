"""`JointAgent`: swing-up from joint positions by models that are exact by construction, and what is refused."""

import gymnasium as gym
import jax
import mujoco
import numpy as np
import pytest
from gymnasium import spaces

from keycld_control import JointAgent
from keycld_envs import KeyCLDEnv
from keycld_envs.errors import InputError
from keycld_model import JointModel
from keycld_model.delan import JointConfig, Motion, Motions
from keycld_model.delan.baseline import fit_baseline
from keycld_model.delan.config import Scales
from keycld_model.delan.families import JointDynamics


def bare(env: gym.Env) -> KeyCLDEnv:
    """The environment itself."""
    assert isinstance(env.unwrapped, KeyCLDEnv)
    return env.unwrapped


def exact_model(env: gym.Env) -> JointModel:
    """Least squares of base parameters, which are exact on random states of the environment's own simulator."""
    model, joints = bare(env).model, bare(env).system.joints
    data, rng, n = mujoco.MjData(model), np.random.default_rng(0), len(joints)
    q, v, a = rng.normal(size=(3, 400, n)) * 2
    tau = np.empty_like(q)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        tau[i] = data.qfrc_inverse
    zero, t = np.zeros_like(q), np.arange(len(q), dtype=np.float64)
    motion = Motion("random", t, q, v, a, tau, zero, zero)
    return fit_baseline(Motions("simulator", tuple(j.name for j in joints), tuple(j.kind for j in joints), (motion,)))


def successes(env: gym.Env, agent: JointAgent, episodes: int, velocities: bool = False) -> int:
    """How many episodes end at the target, from joint positions."""
    count = 0
    for seed in range(episodes):
        _, info = env.reset(seed=seed)
        agent.reset()
        done = False
        while not done:
            action = agent.act(info["qpos"], info["qvel"] if velocities else None)
            assert env.action_space.contains(action)
            _, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        count += info["is_success"]
    return count


def agent_of(env: gym.Env, model: JointModel, **more: object) -> JointAgent:
    """At the environment's own target."""
    system, gear = bare(env).system, bare(env).model.actuator_gear[:, 0]
    words = {"action_space": env.action_space, "timestep": system.timestep} | more
    return JointAgent(model, system.target_qpos, gear, **words)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "limit", "pumps"),
    [("Pendulum", None, False), ("Pendulum", 0.6, True), ("Cartpole", None, False), ("Acrobot", None, False)],
)
def test_it_swings_up_from_joint_positions(name: str, limit: float | None, pumps: bool) -> None:
    env = gym.make(f"KeyCLD/{name}-v0", obs_type="state", start="random", action_limit=limit, max_episode_steps=500)
    agent = agent_of(env, exact_model(env))
    assert (agent.pump is not None) == pumps
    assert successes(env, agent, 3) == 3


@pytest.mark.slow
def test_a_weak_shoulder_pumps_energy() -> None:
    env = gym.make("KeyCLD/Acrobot-v0", obs_type="state", start="hanging", action_limit=6.0)
    agent = agent_of(env, exact_model(env))
    assert agent.pump is not None and agent.pump.joint == 0
    assert successes(env, agent, 2, velocities=True) == 2


def pendulum(family: str = "structured") -> JointModel:
    """An untrained model."""
    one = (1.0,)
    config = JointConfig(("hinge",), ("hinge",), Scales((0.0,), one, one, one, one), family, 4, 1)  # type: ignore[arg-type]
    parameters = JointDynamics(config).initial(0)
    return JointModel(config, jax.tree.map(np.asarray, parameters))


def test_where_nothing_binds_the_model_moves_as_a_damped_oscillator() -> None:
    model = pendulum()
    agent = JointAgent(model, [0.5], 2.0, action_limit=1e6, kp=9.0, kd=6.0)
    q, v = np.array([0.4]), np.array([0.2])
    found = model.forward_dynamics(q, v, 2.0 * agent.act(q, v).astype(np.float64))
    assert found == pytest.approx(9.0 * 0.1 - 6.0 * 0.2, rel=1e-5)
    turned = agent.act(q + 2 * np.pi, v)
    assert turned == pytest.approx(agent.act(q, v), rel=1e-4)


def test_what_cannot_be_used_is_refused() -> None:
    box = spaces.Box(-1.0, 1.0, (1,), np.float32)
    with pytest.raises(InputError, match="no energy"):
        JointAgent(pendulum("feed_forward"), [0.0], action_space=box)
    with pytest.raises(InputError, match="motor at every joint"):
        JointAgent(pendulum(), [0.0], 0.0, action_space=box)
    with pytest.raises(InputError, match=r"target has shape \[2\]"):
        JointAgent(pendulum(), [0.0, 0.0], action_space=box)
    with pytest.raises(InputError, match="kp"):
        JointAgent(pendulum(), [0.0], action_space=box, kp=-1.0)
    agent = JointAgent(pendulum(), [0.0], action_space=box)
    with pytest.raises(InputError, match="timestep"):
        agent.act([0.1])
    with pytest.raises(InputError, match="q holds NaN"):
        agent.act([np.nan], [0.0])
