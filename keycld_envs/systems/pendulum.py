"""Pendulum: one link on a fixed hinge, a bob at its tip."""

import math

import mujoco

from keycld_envs.mechanism import Mechanism, Rod
from keycld_envs.mjcf import Change, Insert, edit, read_suite
from keycld_envs.rewards import tolerance
from keycld_envs.systems.base import Joint, Landmark, System

_CAMERA = {"pos": "0 -2.5 .6", "zaxis": "0 -1 0"}
_EDITS = (
    Change(
        "worldbody/camera[@name='fixed']",
        {
            "pos": ("0 -1.5 2", _CAMERA["pos"]),
            "xyaxes": ("1 0 0 0 1 1", None),
            "zaxis": (None, _CAMERA["zaxis"]),
        },
    ),
    Change("worldbody/body/joint[@name='hinge']", {"damping": ("0.1", "0")}),
    Change("actuator/motor[@name='torque']", {"gear": ("1", "2"), "ctrlrange": ("-1 1", "-3 3")}),
)


def swingup_reward(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """dm_control's pendulum swing-up: 1 while the pole is within 8 degrees of upright, else 0."""
    vertical = data.xmat[model.body("pole").id, 8]
    return tolerance(vertical, (math.cos(math.radians(8)), 1))


def _system(name: str, *edits: Change | Insert, camera: str, action_limit: float | None) -> System:
    xml, assets = read_suite("pendulum")
    return System(
        name=name,
        mjcf=edit(xml, *edits),
        assets=assets,
        joints=(Joint("hinge", "hinge", (-math.pi, math.pi)),),
        actuators=("torque",),
        mechanism=Mechanism(num_keypoints=1, num_actions=1, rods=(Rod(None, 0),)),
        landmarks=(Landmark("pole", (0, 0, 0.5), (0, 0, 0.502)),),
        camera=camera,
        timestep=0.02,
        target_qpos=(0.0,),
        hanging_qpos=(math.pi,),
        reward=swingup_reward,
        action_limit=action_limit,
    )


PENDULUM = _system("pendulum", *_EDITS, camera="fixed", action_limit=3.0)
PENDULUM_STOCK = _system(
    "pendulum-stock",
    Insert("worldbody", "camera", {"name": "frontal", **_CAMERA}),
    camera="frontal",
    action_limit=None,
)
