"""A cart on a rail with a pole, both driven. Change it into your own mechanism, then: keycld check THIS_FILE.

All commands take this file in place of a system's name:

    keycld check my_arm.py                                        # draws it, says what does not fit
    keycld collect my_arm.py --out data/my_arm --workers 2        # 500 recordings of 50 frames
    keycld train my_arm.py --data data/my_arm --out runs/my_arm --preset quick
    keycld evaluate runs/my_arm --data data/my_arm
    keycld swingup my_arm.py --weights runs/my_arm --video swingup.mp4
"""

import math
from pathlib import Path

from keycld_envs import Joint, Landmark, Mechanism, Rod, Slider, System

# The simulation, in MuJoCo's format (https://mujoco.readthedocs.io/en/stable/XMLreference.html). To keep it in a file
# of its own, write mjcf=Path("my_arm.xml") below; the path is relative to this file.
MJCF = """
<mujoco>
  <!-- The world model knows no contacts. The control step (below) is a whole multiple of timestep, in s. -->
  <option timestep="0.005" integrator="RK4"><flag contact="disable"/></option>
  <visual><headlight ambient=".5 .5 .5"/></visual>
  <worldbody>
    <light pos="0 -3 3"/>
    <!-- Motion is in the plane of x (right) and z (up). The camera looks along y, at right angles to it; the mechanism
         should fill most of the square image, and never leave it. -->
    <camera name="front" pos="0 -6 0" zaxis="0 -1 0"/>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="box" size=".2 .1 .12" mass="1" rgba=".2 .5 .8 1"/>
      <body name="pole">
        <joint name="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 1" size=".08" mass=".1" rgba=".9 .6 .2 1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <!-- Force and torque are gear times action, in N and N m. -->
    <motor name="push" joint="rail" gear="4" ctrllimited="true" ctrlrange="-3 3"/>
    <motor name="turn" joint="hinge" ctrllimited="true" ctrlrange="-3 3"/>
  </actuator>
</mujoco>
"""

system = System(
    name=Path(__file__).stem,
    mjcf=MJCF,
    # Every joint of the MJCF, in its order: name, kind, and where recordings start (rad for "hinge", m for "slide").
    joints=(Joint("rail", "slide", (-1.0, 1.0)), Joint("hinge", "hinge", (-math.pi, math.pi))),
    # Every actuator of the MJCF, in its order.
    actuators=("push", "turn"),
    # What the world model knows: two keypoints; keypoint 0 slides on a rail through the pivot, in image units ((0, 0)
    # is the middle, 1 the right or upper border), and cannot move along normal; a rod from 0 to 1. Lengths are learned.
    mechanism=Mechanism(
        num_keypoints=2, num_actions=2, rods=(Rod(0, 1),), sliders=(Slider(0, normal=(0.0, 1.0)),), pivot=(0.0, 0.0)
    ),
    # Where keypoints 0 and 1 truly are: a body of the MJCF, and the position on it, in m. For measuring only.
    landmarks=(Landmark("cart"), Landmark("pole", (0, 0, 1))),
    camera="front",
    # Seconds from frame to frame, and from action to action.
    timestep=0.01,
    # Where to go, and where it hangs still: one number per joint, rad or m.
    target_qpos=(0.0, 0.0),
    hanging_qpos=(0.0, math.pi),
)
