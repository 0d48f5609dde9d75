"""A mechanism of your own, from its MJCF file to control from pixels: declare, record, learn, control.

python examples/own_mechanism.py
"""

import math

import gymnasium as gym

import keycld_envs
from keycld_control import EnergyShapingAgent
from keycld_envs import Joint, Landmark, Mechanism, Rod, System
from keycld_envs.collect import CollectSettings, collect
from keycld_envs.recordings import read_dataset
from keycld_model.config import ModelConfig
from keycld_model.training import train

MJCF = """
<mujoco>
  <option timestep="0.005" integrator="RK4"><flag contact="disable"/></option>
  <visual><headlight ambient=".5 .5 .5"/></visual>
  <worldbody>
    <light pos="0 -2 2"/>
    <camera name="front" pos="0 -3 0" zaxis="0 -1 0"/>
    <body name="crane">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .8" size=".04" mass=".5" rgba=".8 .8 .2 1"/>
      <geom type="box" pos="0 0 .8" size=".1 .04 .1" mass="1" rgba=".9 .3 .2 1"/>
    </body>
  </worldbody>
  <actuator><motor name="torque" joint="hinge" ctrllimited="true" ctrlrange="-15 15"/></actuator>
</mujoco>
"""
CRANE = System(
    name="crane",
    mjcf=MJCF,
    joints=(Joint("hinge", "hinge", (-math.pi, math.pi)),),
    actuators=("torque",),
    mechanism=Mechanism(num_keypoints=1, num_actions=1, rods=(Rod(None, 0),)),  # one rod, from the pivot to its tip
    landmarks=(Landmark("crane", (0, 0, 0.8)),),
    camera="front",
    timestep=0.02,
    target_qpos=(0.8,),  # any configuration will do, not only an upright one
    hanging_qpos=(math.pi,),
)
ENV_ID = "Examples/Crane-v0"
keycld_envs.register(CRANE, ENV_ID)

if __name__ == "__main__":
    collect("data/crane", CollectSettings(ENV_ID), episodes=500)
    config = ModelConfig(CRANE.mechanism, CRANE.timestep, system=ENV_ID)
    model = train(read_dataset("data/crane"), config, "runs/crane").model

    env = gym.make(ENV_ID, max_episode_steps=300)
    agent = EnergyShapingAgent(model, target_img=env.unwrapped.render_qpos(CRANE.target_qpos))
    for seed in range(5):
        obs, info = env.reset(seed=seed)
        agent.reset()
        done = False
        while not done:
            obs, reward, terminated, truncated, info = env.step(agent.act(obs))
            done = terminated or truncated
        print(f"seed {seed}: success {info['is_success']}")
    env.close()
