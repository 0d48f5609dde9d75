"""Positions of a system's joints, from keypoints that may sit anywhere on its links."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_envs.systems import System
from keycld_model.physics import PointMasses

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class JointScales:
    """How a system's joints count what is measured of its keypoints: q = units * measured + zero.

    Attributes:
        order: `[nq]` which of `measured` is each joint's.
        units: `[nq]` 1 or -1 of hinges, by their sense; of slides, m per image unit.
        zero: `[nq]` rad or m.
        turns: `[nq]` which joints are hinges.
    """

    order: NDArray[np.intp]
    units: Floats
    zero: Floats
    turns: NDArray[np.bool_]


def joint_scales(system: System) -> JointScales:
    """Senses, units and zeros of a system's joints, those of its own keypoints.

    Hinges go with rods and slides with sliders, each in order.

    Raises:
        InputError: if they are not as many.
    """
    mechanism, order = system.mechanism, _order(system)
    model = system.compile()
    data = mujoco.MjData(model)

    def seen(qpos: Floats) -> Floats:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        shown = system.keypoints(model, data).ravel()
        return np.asarray(measured(mechanism, jnp.asarray(mechanism.pivot), jnp.asarray(shown)))[order]

    start, step = np.asarray(system.target_qpos, float), 1e-2
    moved = np.array([seen(start + step * row) - seen(start - step * row) for row in np.eye(len(start))])
    turns = np.array([joint.kind == "hinge" for joint in system.joints])
    units = 2 * step / np.where(turns, wrapped(moved.diagonal()), moved.diagonal())
    return JointScales(order, units, start - units * seen(start), turns)


def joint_positions(system: System, points: PointMasses) -> Callable[[Array], Array]:
    """Positions `[nq]` of a system's joints, rad or m, of keypoints `[n]` anywhere on the links; see `joint_scales`."""
    mechanism, pivot, scales = system.mechanism, points.pivot, joint_scales(system)
    units, zero, turns = (jnp.asarray(part) for part in (scales.units, scales.zero, scales.turns))

    def positions(x: Array) -> Array:
        q = units * measured(mechanism, pivot, x)[scales.order] + zero
        return jnp.where(turns, wrapped(q), q)

    return positions


def _order(system: System) -> NDArray[np.intp]:
    """Which rod, or slider behind the rods, is each joint's."""
    rods, sliders = len(system.mechanism.rods), len(system.mechanism.sliders)
    kinds = [joint.kind for joint in system.joints]
    if kinds.count("hinge") != rods or kinds.count("slide") != sliders:
        raise InputError(
            f"System {system.name!r} has {kinds.count('hinge')} hinge(s) for {rods} rod(s) and {kinds.count('slide')} "
            f"slide(s) for {sliders} slider(s), so that effects at its joints have no place in a world model."
        )
    places = [kinds[:j].count(kind) + (0 if kind == "hinge" else rods) for j, kind in enumerate(kinds)]
    return np.array(places, np.intp)


def measured(mechanism: Mechanism, pivot: Array, x: Array) -> Array:
    """Angles of rods, clockwise from up, relative to the rod that each hangs on, and places along rails, `[R + S]`."""
    points = x.reshape(-1, 2)
    along = [points[rod.end] - (pivot if rod.start is None else points[rod.start]) for rod in mechanism.rods]
    angles = [jnp.arctan2(rod[0], rod[1]) for rod in along]
    ends = [rod.end for rod in mechanism.rods]
    out = [
        a - angles[ends.index(r.start)] if r.start in ends else a for a, r in zip(angles, mechanism.rods, strict=True)
    ]
    for slider in mechanism.sliders:
        out.append((points[slider.keypoint] - pivot) @ jnp.array(slider.along, x.dtype))
    return jnp.stack(out)


def wrapped(angles: Any) -> Any:
    """Into [-pi, pi)."""
    return (angles + np.pi) % (2 * np.pi) - np.pi
