"""Videos of pendulums with known angles, drawn with NumPy and compressed like a camera's."""

from contextlib import closing
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_envs.recordings.video import write_video
from keycld_envs.rendering import Renderer
from keycld_model.tracking.pendulum.motion import Motion

Array = NDArray[np.float64]
CAMERA = {"codec": "libx264", "output_params": ["-crf", "23", "-preset", "fast"]}

CHAIN = """
<mujoco>
  <option timestep="0.0008333333333333334" integrator="RK4"/>
  <visual><global offwidth="{width}" offheight="{height}"/></visual>
  <asset>
    <texture name="wall" type="2d" builtin="checker" mark="random" random="0.05" width="512" height="512"
      rgb1=".72 .7 .66" rgb2=".66 .66 .62" markrgb=".4 .4 .45"/>
    <material name="wall" texture="wall" texrepeat="3 3"/>
  </asset>
  <worldbody>
    <light pos="-1 -4 3" dir=".2 .8 -.6" castshadow="false"/>
    <camera name="front" pos="0 -6 0" xyaxes="1 0 0 0 0 1" fovy="18"/>
    <geom type="plane" pos="0 .3 0" xyaxes="1 0 0 0 0 1" size="3 3 .1" material="wall" contype="0" conaffinity="0"/>
    <geom type="cylinder" pos="0 .03 .1" zaxis="0 1 0" size=".04 .02" rgba=".2 .2 .2 1" contype="0" conaffinity="0"/>
    <site name="pivot" pos="0 0 .1"/>
    <body pos="0 0 .1">
      <joint axis="0 -1 0" damping=".004"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".028" mass=".5" rgba=".75 .2 .15 1" contype="0"
        conaffinity="0"/>
      <site name="elbow" pos="0 0 -.4"/>
      <body pos="0 0 -.4">
        <joint axis="0 -1 0" damping=".004"/>
        <joint axis="1 0 0" armature="1000"/>
        <geom type="capsule" fromto="0 -.03 0 0 -.03 -.3" size=".022" mass=".2" rgba=".15 .25 .6 1" contype="0"
          conaffinity="0"/>
        <geom type="sphere" pos="0 0 -.3" size=".045" mass=".2" rgba=".15 .25 .6 1" contype="0" conaffinity="0"/>
        <site name="end" pos="0 0 -.3"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
"""A red link on a dark hub, a blue one with a bob on its end; the hinges' axes point to the camera."""


def nothing(steps: int = 1, note: str | None = None) -> None:
    """A progress bar that shows nothing."""


def swing(times: Array, terms: tuple[str, ...] = ("viscous_friction",), sizes: tuple[float, ...] = (0.1,)) -> Array:
    """Angles of a free pendulum of period 1.2 s, from 0.6 rad at rest."""
    parameters = np.array([[2 * np.log(2 * np.pi / 1.2), 0.0, 0.6, 0.0, *sizes]])
    return Motion(terms).simulate(parameters, times)[0]


def draw_pendulum(
    path: Path, angles: Array, size: tuple[int, int], pivot: Array, length: float, *, fps: float = 30.0,
    hidden: slice | None = None, seed: int = 0,
) -> Array:  # fmt: skip
    """Write a video of a bob on a string before a textured wall, with noise.

    Args:
        path: ends in .mp4.
        angles: [T], rad, from the downward direction, counter-clockwise.
        size: (W, H), pixels.
        pivot: [2], pixels; may lie outside.
        length: pixels.
        fps: frames per second.
        hidden: frames in which the bob is covered.
        seed: of the wall and of the noise.

    Returns:
        [T, 2], true centres of the bob, pixels.
    """
    rng = np.random.default_rng(seed)
    width, height = size
    wall = 170 + 25 * gaussian_filter(rng.normal(size=(height, width)), 6) * 6
    wall = np.repeat(wall[..., None], 3, axis=2)
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    bobs = pivot + length * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    radius = 0.035 * width

    def frames():
        for t, (bx, by) in enumerate(bobs):
            image = wall.copy()
            if hidden is None or not hidden.start <= t < hidden.stop:
                dx, dy = np.array([bx, by]) - pivot
                across = np.abs((x - pivot[0]) * dy - (y - pivot[1]) * dx) / length
                string = np.clip(1.5 - across, 0, 1) * ((x - bx) * dx + (y - by) * dy < 0)
                bob = np.clip(radius + 0.5 - np.hypot(x - bx, y - by), 0, 1)
                image += string[..., None] * (np.array([60, 60, 70]) - image)
                image += bob[..., None] * (np.array([190, 40, 50]) - image)
            yield np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)

    write_video(path, frames(), size, fps, **CAMERA)
    return bobs


def draw_chain(
    path: Path, seconds: float, size: tuple[int, int], *, fps: float = 30.0, hidden: slice | None = None,
    leaning: slice | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Render a free double pendulum before a marked wall, with MuJoCo.

    Args:
        path: ends in .mp4.
        seconds: of the video.
        size: (W, H), pixels.
        fps: frames per second.
        hidden: frames in which the end of the second link is covered.
        leaning: frames in which the second link leans towards the camera by 0.7 rad.

    Returns:
        [T, 3, 2] pivot and ends of both links, pixels, and [T, 2] joint angles, rad.
    """
    model = mujoco.MjModel.from_xml_string(CHAIN.format(width=size[0], height=size[1]))
    data = mujoco.MjData(model)
    data.qpos[:2] = 1.1, 0.7
    ends, angles = [], []
    each = round(1 / fps / model.opt.timestep)
    focal = size[1] / 2 / np.tan(np.radians(model.cam_fovy[0]) / 2)

    def frames():
        with closing(Renderer(model, *size, "full")) as renderer:
            for t in range(round(seconds * fps)):
                data.qpos[2] = 0.7 if leaning is not None and leaning.start <= t < leaning.stop else 0.0
                mujoco.mj_forward(model, data)
                away = data.site_xpos - model.cam_pos[0]
                ends.append((np.array(size) - 1) / 2 + focal * away[:, [0, 2]] * (1, -1) / away[:, 1:2])
                angles.append(data.qpos[:2].copy())
                picture = renderer.render(data, "front")
                if hidden is not None and hidden.start <= t < hidden.stop:
                    column, row = ends[-1][2].astype(int)
                    half = size[0] // 12
                    picture[max(0, row - half) : row + half, max(0, column - half) : column + half] = 90
                yield picture
                mujoco.mj_step(model, data, each)

    write_video(path, frames(), size, fps, **CAMERA)
    return np.array(ends), np.array(angles)
