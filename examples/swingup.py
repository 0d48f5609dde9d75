"""Swing the acrobot up from pixels: learned energy, one target image.

python examples/swingup.py
"""

import gymnasium as gym

import keycld_envs  # noqa: F401  registers the environments
from keycld_control import EnergyShapingAgent
from keycld_model import WorldModel

if __name__ == "__main__":
    env = gym.make("KeyCLD/Acrobot-v0")
    agent = EnergyShapingAgent(WorldModel.load("acrobot"), target_img=env.unwrapped.render_qpos([0.0, 0.0]))
    obs, info = env.reset(seed=0)
    done = False
    while not done:
        obs, reward, terminated, truncated, info = env.step(agent.act(obs))
        done = terminated or truncated
    print("success:", info["is_success"])
    env.close()
