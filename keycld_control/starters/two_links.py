"""An arm of two links. Change it into your own mechanism, then: keycld check THIS_FILE.

All commands take this file in place of a system's name:

    keycld check my_arm.py                                        # draws it, says what does not fit
    keycld collect my_arm.py --out data/my_arm --workers 2        # 500 recordings of 50 frames
    keycld train my_arm.py --data data/my_arm --out runs/my_arm --preset quick
    keycld evaluate runs/my_arm --data data/my_arm
    keycld swingup my_arm.py --weights runs/my_arm --video swingup.mp4
"""

import math
from pathlib import Path

from keycld_envs import Joint, Landmark, Mechanism, Rod, System

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
    <camera name="front" pos="0 -5 0" zaxis="0 -1 0"/>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .8" size=".08" mass="1" rgba=".2 .5 .8 1"/>
      <body name="lower" pos="0 0 .8">
        <joint name="elbow" axis="0 1 0"/>
        <!-- Links of different colours are told apart most easily. -->
        <geom type="capsule" fromto="0 0 0 0 0 .8" size=".08" mass="1" rgba=".9 .6 .2 1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <!-- Torque is gear times action, in N m. -->
    <motor name="shoulder" joint="shoulder" gear="2" ctrllimited="true" ctrlrange="-15 15"/>
    <motor name="elbow" joint="elbow" gear="2" ctrllimited="true" ctrlrange="-15 15"/>
  </actuator>
</mujoco>
"""

system = System(
    name=Path(__file__).stem,
    mjcf=MJCF,
    # Every joint of the MJCF, in its order: name, kind, and where recordings start (rad for "hinge", m for "slide").
    joints=(
        Joint("shoulder", "hinge", (-math.pi, math.pi)),
        Joint("elbow", "hinge", (-math.pi, math.pi)),
    ),
    # Every actuator of the MJCF, in its order.
    actuators=("shoulder", "elbow"),
    # What the world model knows: two keypoints; a rod from the pivot to keypoint 0, and one from 0 to 1. Lengths are
    # learned. The pivot is where that rod is fixed, in image units: (0, 0) is the middle, 1 the right or upper border.
    mechanism=Mechanism(num_keypoints=2, num_actions=2, rods=(Rod(None, 0), Rod(0, 1)), pivot=(0.0, 0.0)),
    # Where keypoints 0 and 1 truly are: a body of the MJCF, and the position on it, in m. For measuring only.
    landmarks=(Landmark("upper", (0, 0, 0.8)), Landmark("lower", (0, 0, 0.8))),
    camera="front",
    # Seconds from frame to frame, and from action to action.
    timestep=0.01,
    # Where to go, and where it hangs still: one number per joint, rad or m.
    target_qpos=(0.0, 0.0),
    hanging_qpos=(math.pi, 0.0),
)
