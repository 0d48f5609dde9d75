"""Acrobot: two links, the first on a fixed hinge."""

import math

import mujoco
import numpy as np

from keycld_envs.mechanism import Mechanism, Rod
from keycld_envs.mjcf import Change, Insert, edit, read_suite
from keycld_envs.rewards import tolerance
from keycld_envs.systems.base import Joint, Landmark, System

_UPPER = "worldbody/body[@name='upper_arm']"
_EDITS = (
    Change("worldbody/camera[@name='fixed']", {"pos": ("0 -6 2", "0 -6 2.1")}),
    Change("default/joint", {"damping": (".05", "0")}),
    Change("worldbody/geom[@name='floor']", {"size": ("3 3 .2", "6 6 .2")}),
    Change(_UPPER, {"pos": ("0 0 2", "0 0 2.1")}),
    Change(f"{_UPPER}/geom[@name='upper_arm']", {"size": ("0.05", "0.100"), "material": ("self", "decoration")}),
    Change(f"{_UPPER}/body/geom[@name='lower_arm']", {"size": ("0.049", "0.099")}),
    Change("actuator/motor[@name='elbow']", {"ctrlrange": ("-1 1", "-3 3")}),
    Insert(
        "actuator",
        "motor",
        {"name": "shoulder", "joint": "shoulder", "gear": "2", "ctrllimited": "true", "ctrlrange": "-3 3"},
        index=0,
    ),
)


def swingup_reward(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """dm_control's smooth acrobot swing-up: distance of the tip from the target above the pivot."""
    target = model.site("target").id
    distance = np.linalg.norm(data.site_xpos[target] - data.site_xpos[model.site("tip").id])
    return tolerance(float(distance), bounds=(0, model.site_size[target, 0]), margin=1)


def _system(
    name: str,
    *edits: Change | Insert,
    actuators: tuple[str, ...],
    lower_mass: float,
    camera: str,
    action_limit: float | None,
    weak_limit: float | None,
) -> System:
    xml, assets = read_suite("acrobot")
    return System(
        name=name,
        mjcf=edit(xml, *edits),
        assets=assets,
        joints=(
            Joint("shoulder", "hinge", (-math.pi, math.pi)),
            Joint("elbow", "hinge", (-math.pi, math.pi)),
        ),
        actuators=actuators,
        mechanism=Mechanism(num_keypoints=2, num_actions=len(actuators), rods=(Rod(None, 0), Rod(0, 1))),
        landmarks=(Landmark("upper_arm", (0, 0, 1), (0, 0, 1)), Landmark("lower_arm", (0, 0, 1), (0, 0, lower_mass))),
        camera=camera,
        timestep=0.01,
        target_qpos=(0.0, 0.0),
        hanging_qpos=(math.pi, 0.0),
        reward=swingup_reward,
        action_limit=action_limit,
        weak_limit=weak_limit,
    )


ACROBOT = _system(
    "acrobot",
    *_EDITS,
    actuators=("shoulder", "elbow"),
    lower_mass=0.71944,
    camera="fixed",
    action_limit=15.0,
    weak_limit=3.0,  # the paper's
)
ACROBOT_STOCK = _system(
    "acrobot-stock",
    Insert("worldbody", "camera", {"name": "frontal", "pos": "0 -6 2", "zaxis": "0 -1 0"}),
    actuators=("elbow",),
    lower_mass=0.69061,
    camera="frontal",
    action_limit=None,
    weak_limit=None,
)
