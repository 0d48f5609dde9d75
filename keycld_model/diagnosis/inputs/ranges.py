"""Where motion leaves the range of another."""

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Paths(NamedTuple):
    """Motion in W windows of S steps.

    Attributes:
        q: `[W, S, nv]` positions, rad or m.
        v: `[W, S, nv]` velocities.
        u: `[W, S, nu]` commands.
    """

    q: Array
    v: Array
    u: Array


def beyond(model: mujoco.MjModel, known: Paths, paths: Paths) -> dict[str, NDArray[np.bool_]]:
    """Channels such as "speed of elbow", and where paths leave what is known by more than a tenth of it, `[W, S]`.

    Hinges that turn round have no end.
    """
    joints, motors = ([x(i).name for i in range(n)] for x, n in ((model.joint, model.njnt), (model.actuator, model.nu)))
    kinds = [("position", known.q, paths.q, joints), ("speed", known.v, paths.v, joints)]
    out = {}
    for kind, before, values, names in (*kinds, ("command", known.u, paths.u, motors)):
        for i, name in enumerate(names):
            x, y = before[..., i], values[..., i]
            if kind == "position" and model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE:
                x, y = (np.mod(z + np.pi, 2 * np.pi) - np.pi for z in (x, y))
            low, high = np.quantile(x, [0.005, 0.995])  # single samples do not count
            margin = 0.1 * (high - low)
            out[f"{kind} of {name}"] = (y < low - margin) | (y > high + margin)
    return out


def notable(shares: Mapping[str, float]) -> dict[str, float]:
    """Shares of the time of more than 2 %, as they are reported."""
    return {channel: round(share, 4) for channel, share in shares.items() if share > 0.02}
