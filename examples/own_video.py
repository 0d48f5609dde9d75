"""A video to try `keycld import` with: two minutes of a swinging pendulum or double pendulum, as a phone would film it.

python examples/own_video.py double_pendulum double.mp4
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import keycld_envs  # noqa: F401  # isort: skip  (before mujoco: it finds out how to draw without a screen)

import mujoco
import numpy as np

from keycld_envs.recordings.video import write_video

MJCF = """
<mujoco>
  <option timestep=".002" integrator="RK4"><flag contact="disable"/></option>
  <visual>
    <global offwidth="1280" offheight="720"/><quality offsamples="0" shadowsize="0"/><headlight ambient=".5 .5 .5"/>
  </visual>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1=".75 .78 .8" rgb2=".5 .52 .55" width="64" height="64"/>
  </asset>
  <worldbody>
    <light pos="-1 -3 3"/>
    <camera name="phone" pos="0 -3.2 -.2" zaxis="0 -1 0"/>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".035" mass=".3" rgba=".2 .3 .8 1"/>
      <geom type="cylinder" fromto="0 -.04 -.5 0 .04 -.5" size=".09" mass=".6" rgba=".9 .5 .1 1"/>
      {lower}
    </body>
  </worldbody>
</mujoco>
"""
LOWER = """
<body name="lower" pos="0 0 -.5">
  <joint name="elbow" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass=".2" rgba=".1 .6 .4 1"/>
  <geom type="cylinder" fromto="0 -.04 -.4 0 .04 -.4" size=".075" mass=".4" rgba=".85 .1 .2 1"/>
</body>
"""
KINDS = {"pendulum": (MJCF.format(lower=""), (2.4,)), "double_pendulum": (MJCF.format(lower=LOWER), (1.3, 0.6))}
"""The model, and the angles that it is released at."""
RATE, SIZE = 50, (1280, 720)


def frames(kind: str, seconds: float) -> Iterator[np.ndarray]:
    """Let go, and film."""
    mjcf, start = KINDS[kind]
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    renderer = mujoco.Renderer(model, SIZE[1], SIZE[0])
    for _ in range(round(seconds * RATE)):
        mujoco.mj_step(model, data, round(1 / RATE / model.opt.timestep))
        renderer.update_scene(data, "phone")
        yield renderer.render()
    renderer.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=120.0)
    args = parser.parse_args()
    compressed = {"codec": "libx264", "output_params": ["-crf", "26", "-preset", "fast"]}
    write_video(args.out, frames(args.kind, args.seconds), SIZE, RATE, **compressed)
