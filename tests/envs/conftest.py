import importlib
import os
from collections.abc import Callable
from typing import Any

import pytest

os.environ.setdefault("MUJOCO_GL", "egl")  # dm_control, which the tests compare with, would pick GLFW first

from keycld_envs import REFERENCE_SYSTEMS, SYSTEMS, Joint, Landmark, Mechanism, Slider, System

MJCF = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <light pos="0 -1 2"/>
    <camera name="front" pos="0 -2 0" zaxis="0 -1 0"/>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="box" size=".1 .1 .1" mass="2"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail" ctrllimited="true" ctrlrange="-2 2"/></actuator>
</mujoco>
"""
SLIDER = System(
    name="slider",
    mjcf=MJCF,
    joints=(Joint("rail", "slide", (-0.5, 0.5)),),
    actuators=("push",),
    mechanism=Mechanism(num_keypoints=1, num_actions=1, sliders=(Slider(0),)),
    landmarks=(Landmark("cart"),),
    camera="front",
    timestep=0.02,
    target_qpos=(0.0,),
    hanging_qpos=(0.3,),
)
DOMAINS = [name for name in REFERENCE_SYSTEMS if f"{name}-stock" in SYSTEMS]


@pytest.fixture(params=sorted(SYSTEMS))
def name(request: pytest.FixtureRequest) -> str:
    """Every system, both variants."""
    return request.param


@pytest.fixture(params=DOMAINS)
def domain(request: pytest.FixtureRequest) -> str:
    """Every dm_control domain."""
    return request.param


@pytest.fixture
def slider() -> System:
    """A mechanism of one's own: a cart on a rail, without textures."""
    return SLIDER


@pytest.fixture
def dm_control() -> Callable[[str], Any]:
    """Imports a module of dm_control."""
    pytest.importorskip("dm_control", reason="compares with dm-control, which does not install on this Python")
    return lambda name: importlib.import_module(f"dm_control.{name}")
