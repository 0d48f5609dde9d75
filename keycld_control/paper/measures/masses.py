"""Learned masses, lengths and weights against those of point masses that move exactly as the bodies do."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.plant import mass_points, rod_lengths, rods
from keycld_envs import get_system
from keycld_envs.projection import world_to_image
from keycld_envs.systems.base import System
from keycld_model import WorldModel

POSES = 20


def learned_masses(model: WorldModel, system: str, unit: float) -> dict[str, Any]:
    """Learned masses, where they are, and how strongly gravity pulls at them, beside the equivalent point masses.

    Args:
        model: the world model.
        system: short name.
        unit: joules per learned unit of V, see `potential`.

    Returns:
        "ratio", "exact" and "error" of m1/m2, None for a single mass; "lengths", learned rod lengths over exact ones;
        "potential", V per kinetic energy over the true ratio: both share the factor that motion leaves open.
    """
    what = get_system(system)
    exact = equivalent_masses(what)
    lengths, scale = _geometry(what, model.image_shape)
    learned = np.sqrt(2 * model.level[: len(lengths)])
    out: dict[str, Any] = {"ratio": None, "exact": None, "error": None}
    if len(exact) > 1:
        ratio, true = float(model.masses[0] / model.masses[1]), exact[0] / exact[1]
        out = {"ratio": ratio, "exact": true, "error": abs(ratio / true - 1)}
    kinetic = sum(exact) / scale**2  # joules per learned unit of kinetic energy: learned masses sum to one
    return out | {"lengths": (learned / (scale * lengths)).tolist(), "potential": kinetic / unit}


def _geometry(system: System, image_shape: tuple[int, int]) -> tuple[NDArray[np.floating], float]:
    """Lengths `[R]` of the rods between mass positions, m, and image units per metre at the last of them."""
    model = system.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lengths = rod_lengths(system)
    start, end = world_to_image(model, data, rods(system, data)[-1], system.camera, *reversed(image_shape))
    return lengths, float(np.linalg.norm(end - start) / lengths[-1])


def equivalent_masses(system: System) -> list[float]:
    """Point masses, kg, at the mass positions that a system declares, whose inertia in all poses is that of its bodies.

    Least squares over random poses; for the reference systems they agree to 1e-4 (tests/model/test_physics.py).
    """
    model = system.compile()
    data, rows, right = mujoco.MjData(model), [], []
    for qpos in np.random.default_rng(0).uniform(-3, 3, (POSES, model.nq)):
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        inertia, jacobian = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        own = []
        for mark, point in zip(system.landmarks, mass_points(system, data), strict=True):
            mujoco.mj_jac(model, data, jacobian, None, point, model.body(mark.body).id)
            own.append((jacobian.T @ jacobian).ravel())
        rows.append(np.stack(own, axis=1))
        right.append(inertia.ravel())
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0].tolist()
