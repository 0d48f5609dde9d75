"""Cartpole: a cart on a straight rail, a pole hinged to it."""

import math

import mujoco

from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_envs.mjcf import Change, Insert, edit, read_suite
from keycld_envs.rewards import tolerance
from keycld_envs.systems.base import Joint, Landmark, Start, System

_CAMERA = {"pos": "0 -6 1", "zaxis": "0 -1 0"}
_POLE_DEFAULTS = "default/default[@class='pole']"
_EDITS = (
    Change("worldbody/camera[@name='fixed']", {"pos": ("0 -4 1", _CAMERA["pos"])}),
    Change(f"{_POLE_DEFAULTS}/joint", {"damping": ("2e-6", "0")}),
    Change(f"{_POLE_DEFAULTS}/geom", {"size": ("0.045", "0.09")}),
    Change("worldbody/geom[@name='floor']", {"pos": ("0 0 -.05", "0 0 -.20")}),
    Change("worldbody/geom[@name='rail1']", {"size": ("0.02 2", "0.02 4")}),
    Change("worldbody/geom[@name='rail2']", {"size": ("0.02 2", "0.02 4")}),
    Change("worldbody/body/joint[@name='slider']", {"limited": ("true", "false"), "damping": ("5e-4", "0")}),
    Change("worldbody/body/geom[@name='cart']", {"material": ("self", "decoration")}),
    Change("actuator/motor[@name='slide']", {"gear": ("10", "4"), "ctrlrange": ("-1 1", "-3 3")}),
    Insert(
        "actuator",
        "motor",
        {"name": "hinge_1", "joint": "hinge_1", "gear": "1", "ctrllimited": "true", "ctrlrange": "-3 3"},
    ),
)


def swingup_reward(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """dm_control's smooth cartpole swing-up: upright, centred, with small control and a slow pole."""
    upright = (data.xmat[model.body("pole_1").id, 8] + 1) / 2
    centered = (1 + tolerance(data.qpos[0], margin=2)) / 2
    small_control = (4 + tolerance(data.ctrl[0], margin=1, value_at_margin=0, sigmoid="quadratic")) / 5
    small_velocity = (1 + tolerance(data.qvel[1], margin=5)) / 2
    return float(upright * small_control * small_velocity * centered)


def _system(
    name: str,
    *edits: Change | Insert,
    actuators: tuple[str, ...],
    pole_mass: float,
    camera: str,
    action_limit: float | None,
    start: Start,
) -> System:
    xml, assets = read_suite("cartpole")
    return System(
        name=name,
        mjcf=edit(xml, *edits),
        assets=assets,
        joints=(Joint("slider", "slide", (-1.0, 1.0)), Joint("hinge_1", "hinge", (-math.pi, math.pi))),
        actuators=actuators,
        mechanism=Mechanism(num_keypoints=2, num_actions=len(actuators), sliders=(Slider(0),), rods=(Rod(0, 1),)),
        landmarks=(Landmark("cart", (0, 0, 0), (0, 0, 0)), Landmark("pole_1", (0, 0, 1), (0, 0, pole_mass))),
        camera=camera,
        timestep=0.01,
        target_qpos=(0.0, 0.0),
        hanging_qpos=(0.0, math.pi),
        reward=swingup_reward,
        action_limit=action_limit,
        start=start,
    )


CARTPOLE = _system(
    "cartpole",
    *_EDITS,
    actuators=("slide", "hinge_1"),
    pole_mass=0.71392,
    camera="fixed",
    action_limit=3.0,
    start="random",
)
CARTPOLE_STOCK = _system(
    "cartpole-stock",
    Insert("worldbody", "camera", {"name": "frontal", **_CAMERA}),
    actuators=("slide",),
    pole_mass=0.68849,
    camera="frontal",
    action_limit=None,
    start="hanging",
)
