"""Positions of a system's joints, from keypoints that may sit anywhere on its links."""

from collections.abc import Callable
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


def joint_positions(system: System, points: PointMasses) -> Callable[[Array], Array]:
    """Positions `[nq]` of a system's joints, rad or m, of keypoints `[n]` anywhere on the links.

    Hinges go with rods and slides with sliders, each in order; senses, units and zeros are those of the system's own
    keypoints.
    """
    mechanism, pivot = system.mechanism, points.pivot
    order = _order(system)
    model = system.compile()
    data = mujoco.MjData(model)

    def seen(qpos: Floats) -> Floats:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        shown = system.keypoints(model, data).ravel()
        return np.asarray(_measures(mechanism, jnp.asarray(mechanism.pivot), jnp.asarray(shown)))[order]

    start, step = np.asarray(system.target_qpos, float), 1e-2
    moved = np.array([seen(start + step * row) - seen(start - step * row) for row in np.eye(len(start))])
    units = jnp.asarray(2 * step / _wrapped(moved.diagonal()))
    zero = jnp.asarray(start - np.asarray(units) * seen(start))
    turns = jnp.asarray([joint.kind == "hinge" for joint in system.joints])

    def positions(x: Array) -> Array:
        q = units * _measures(mechanism, pivot, x)[order] + zero
        return jnp.where(turns, _wrapped(q), q)

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


def _measures(mechanism: Mechanism, pivot: Array, x: Array) -> Array:
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


def _wrapped(angles: Any) -> Any:
    """Into [-pi, pi)."""
    return (angles + np.pi) % (2 * np.pi) - np.pi
