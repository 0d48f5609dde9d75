"""Learn the joints of a mechanism from random motion, then swing it up from joint positions; count successes.

python examples/joint_swingup.py [pendulum | acrobot | cartpole] [limit of the actions]
"""

import sys
import tempfile

import gymnasium as gym
import numpy as np

import keycld_envs  # noqa: F401  registers the environments
from keycld_control import JointAgent
from keycld_model import JointModel
from keycld_model.delan import Motion, Motions, Preset, train

EPISODES = 20
SHARE = 0.1
"""Of the limits of the motors, in motions to learn from; the acrobot's could spin its elbow 20 times a second."""


def excite(env: gym.Env, runs: int = 40, steps: int = 100) -> Motions:
    """Motions under random torques, as a robot logs them: positions, velocities, accelerations, torques."""
    bare, rng, motions = env.unwrapped, np.random.default_rng(0), []
    h, joints = bare.system.timestep, bare.system.joints
    for run in range(runs):
        bare.reset(seed=run)
        rows = []
        for step in range(steps):
            if step % 15 == 0:
                action = SHARE * rng.uniform(-1, 1, env.action_space.shape) * bare.action_space.high
            before = bare.data.qvel.copy()
            q = bare.data.qpos.copy()
            bare.step(action.astype(np.float32))
            middle = (bare.data.qpos + q) / 2, (bare.data.qvel + before) / 2, (bare.data.qvel - before) / h
            rows.append((step * h, *middle, bare.data.qfrc_actuator.copy()))
        t, q, v, a, tau = (np.array(column) for column in zip(*rows, strict=True))
        motions.append(Motion(f"run {run}", t, q, v, a, tau, np.zeros_like(q), np.zeros_like(q)))
    return Motions(env.spec.id, tuple(j.name for j in joints), tuple(j.kind for j in joints), tuple(motions))


def learn(env: gym.Env) -> JointModel:
    """A structured model of the joints."""
    with tempfile.TemporaryDirectory() as folder:
        return train(excite(env), folder, Preset("structured", "small", width=16, iterations=60)).model


def swing_up(env: gym.Env, agent: JointAgent, seed: int) -> bool:
    """One episode: the agent sees joint positions alone."""
    _, info = env.reset(seed=seed)
    agent.reset()
    done = False
    while not done:
        _, _, terminated, truncated, info = env.step(agent.act(info["qpos"]))
        done = terminated or truncated
    return bool(info["is_success"])


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "pendulum"
    limit = float(sys.argv[2]) if len(sys.argv) > 2 else None
    model = learn(gym.make(f"KeyCLD/{name.capitalize()}-v0", obs_type="state", start="random"))
    env = gym.make(f"KeyCLD/{name.capitalize()}-v0", obs_type="state", start="random", action_limit=limit)
    system, gear = env.unwrapped.system, env.unwrapped.model.actuator_gear[:, 0]
    agent = JointAgent(model, system.target_qpos, gear, action_space=env.action_space, timestep=system.timestep)
    up = sum(swing_up(env, agent, seed) for seed in range(EPISODES))
    print(f"{name}: {'pumps energy' if agent.pump else 'lifts directly'}, {up} of {EPISODES} episodes succeed")
