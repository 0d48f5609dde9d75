"""Drawn pendulums, double pendulums, cartpoles, and arms of any number of links."""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from keycld_envs import Joint, Landmark, Mechanism, Rod, Slider, System

Array = NDArray[np.floating]
Kind = Literal["pendulum", "double_pendulum", "cartpole"]
KINDS: tuple[Kind, ...] = ("pendulum", "double_pendulum", "cartpole")
GRAVITY = 9.81
FILLED = 0.75
"""Half of the frame that the mechanism reaches across, at most."""
MOTORS = {"pendulum": ("hinge",), "double_pendulum": ("shoulder", "elbow"), "cartpole": ("slide", "hinge")}
_ROUND = (-math.pi, math.pi)
_HEAD = """
<mujoco>
  <option timestep="{step}" integrator="RK4"><flag contact="disable"/></option>
  <visual><headlight ambient=".4 .4 .4" diffuse=".6 .6 .6" specular="0 0 0"/></visual>
  <default>
    <joint axis="0 1 0"/><geom type="capsule"/><motor ctrllimited="true" ctrlrange="-3 3"/>
  </default>
  <worldbody>
    <light pos="0 -3 6"/>
    <camera name="front" pos="0 {distance} 0" zaxis="0 -1 0"/>
    <geom type="plane" size="9 9 .1" pos="0 2 0" zaxis="0 -1 0" rgba=".2 .24 .3 1"/>
    {bodies}
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
_LINK = """
<body name="{name}" pos="0 0 {at}"><joint name="{joint}"/>
  <geom fromto="0 0 0 0 0 {length}" size="{radius}" mass="{mass}" rgba="{colour}"/>{inside}</body>
"""
_CART = """
<geom fromto="-4 .3 0 4 .3 0" size=".02" rgba=".5 .5 .5 1"/>
<body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
  <geom type="box" size=".2 .15 .1" mass="{mass}" rgba=".3 .5 .7 1"/>{inside}</body>
"""
_BLUE, _SAND, _RED = ".3 .5 .7 1", ".8 .6 .3 1", ".8 .35 .3 1"


def drawn_mechanism(kind: Kind, seed: int) -> System:
    """A mechanism with drawn lengths (m), masses (kg) and motors.

    Args:
        kind: what it is.
        seed: of lengths, masses and motors.
    """
    rng = np.random.default_rng((seed, KINDS.index(kind)))
    lengths, masses = rng.uniform(0.7, 1.2, 2), np.exp(rng.uniform(np.log(0.4), np.log(2.5), 2))
    strength = rng.uniform(0.7, 1.3, 2)
    weight = GRAVITY * masses * lengths / 2  # N m, of level links
    if kind == "pendulum":
        return _pendulum(f"{kind}-{seed}", lengths[0], masses[0], strength[0] * weight[0] / 3)
    if kind == "double_pendulum":
        return _double_pendulum(f"{kind}-{seed}", lengths, masses, strength * [weight.sum(), weight[1]] / 3)
    cart = masses[1] * np.exp(rng.uniform(np.log(1.5), np.log(8.0)))
    gears = strength * [6 * (cart + masses[1]), weight[1]] / 3
    return _cartpole(f"{kind}-{seed}", lengths[1], (cart, masses[1]), gears)


def drawn_arm(links: int, seed: int) -> System:
    """A fully driven chain of links with drawn lengths (m), masses (kg) and motors.

    A motor is .7 to 1.3 times as strong as what holds all links that it carries level.

    Args:
        links: how many.
        seed: of lengths, masses and motors.
    """
    rng = np.random.default_rng((seed, len(KINDS), links))
    lengths, masses = rng.uniform(0.5, 1.0, links), np.exp(rng.uniform(np.log(0.4), np.log(2.5), links))
    weights = GRAVITY * masses
    holding = [sum(weights[j] * (lengths[i:j].sum() + lengths[j] / 2) for j in range(i, links)) for i in range(links)]
    strength, joints = rng.uniform(0.7, 1.3, links), [f"joint_{i}" for i in range(links)]
    inside, colours, radius = "", (_BLUE, _SAND, _RED), 0.04 * lengths.sum()
    for i in reversed(range(links)):
        at = 0.0 if i == 0 else lengths[i - 1]
        inside = _link(f"link_{i}", joints[i], lengths[i], masses[i], radius, colours[i % 3], at=at, inside=inside)
    gears = {joint: gear / 3 for joint, gear in zip(joints, strength * holding, strict=True)}
    step = 0.02 if links == 1 else 0.01
    return System(
        name=f"arm-{links}-{seed}",
        mjcf=_document(step, lengths.sum(), inside, gears),
        joints=tuple(Joint(joint, "hinge", _ROUND) for joint in joints),
        actuators=tuple(joints),
        mechanism=Mechanism(
            num_keypoints=links, num_actions=links, rods=tuple(Rod(i - 1 if i else None, i) for i in range(links))
        ),
        landmarks=tuple(Landmark(f"link_{i}", (0, 0, lengths[i])) for i in range(links)),
        camera="front",
        timestep=step,
        target_qpos=(0.0,) * links,
        hanging_qpos=(math.pi, *(0.0,) * (links - 1)),
    )


def _pendulum(name: str, length: float, mass: float, gear: float) -> System:
    link = _link("link", "hinge", length, mass, 0.06 * length, _SAND)
    return System(
        name=name,
        mjcf=_document(0.02, length, link, {"hinge": gear}),
        joints=(Joint("hinge", "hinge", _ROUND),),
        actuators=MOTORS["pendulum"],
        mechanism=Mechanism(num_keypoints=1, num_actions=1, rods=(Rod(None, 0),)),
        landmarks=(Landmark("link", (0, 0, length)),),
        camera="front",
        timestep=0.02,
        target_qpos=(0.0,),
        hanging_qpos=(math.pi,),
    )


def _double_pendulum(name: str, lengths: Array, masses: Array, gears: Array) -> System:
    lower = _link("lower", "elbow", lengths[1], masses[1], 0.08, _SAND, at=lengths[0])
    upper = _link("upper", "shoulder", lengths[0], masses[0], 0.08, _BLUE, inside=lower)
    return System(
        name=name,
        mjcf=_document(0.01, lengths.sum(), upper, dict(zip(MOTORS["double_pendulum"], gears, strict=True))),
        joints=(Joint("shoulder", "hinge", _ROUND), Joint("elbow", "hinge", _ROUND)),
        actuators=MOTORS["double_pendulum"],
        mechanism=Mechanism(num_keypoints=2, num_actions=2, rods=(Rod(None, 0), Rod(0, 1))),
        landmarks=(Landmark("upper", (0, 0, lengths[0])), Landmark("lower", (0, 0, lengths[1]))),
        camera="front",
        timestep=0.01,
        target_qpos=(0.0, 0.0),
        hanging_qpos=(math.pi, 0.0),
    )


def _cartpole(name: str, length: float, masses: tuple[float, float], gears: Array) -> System:
    pole = _link("pole", "hinge", length, masses[1], 0.08, _SAND)
    return System(
        name=name,
        mjcf=_document(
            0.01,
            length + 1.0,
            _CART.format(mass=masses[0], inside=pole),
            dict(zip(MOTORS["cartpole"], gears, strict=True)),
        ),
        joints=(Joint("slide", "slide", (-0.7, 0.7)), Joint("hinge", "hinge", _ROUND)),
        actuators=MOTORS["cartpole"],
        mechanism=Mechanism(num_keypoints=2, num_actions=2, sliders=(Slider(0),), rods=(Rod(0, 1),)),
        landmarks=(Landmark("cart"), Landmark("pole", (0, 0, length))),
        camera="front",
        timestep=0.01,
        target_qpos=(0.0, 0.0),
        hanging_qpos=(0.0, math.pi),
    )


def _link(name: str, joint: str, length: float, mass: float, radius: float, colour: str, **more: object) -> str:
    about = {"at": 0, "inside": "", **more}
    return _LINK.format(name=name, joint=joint, length=length, mass=mass, radius=radius, colour=colour, **about)


def _document(step: float, reach: float, bodies: str, gears: dict[str, float]) -> str:
    distance = reach / FILLED / math.tan(math.radians(45) / 2)
    motors = "".join(f'<motor name="{name}" joint="{name}" gear="{gear}"/>' for name, gear in gears.items())
    return _HEAD.format(step=step, distance=-distance, bodies=bodies, motors=motors)
