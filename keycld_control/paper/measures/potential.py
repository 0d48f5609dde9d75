"""Figures 8 to 12: potential energy while one joint goes through its range, against the true one."""

from contextlib import closing
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.plant import energy
from keycld_envs import KeyCLDEnv, System, get_system
from keycld_model import WorldModel

POINTS = 73


@dataclass(frozen=True)
class Sweep:
    """One joint through the range of its random starts, the others where they hang.

    Attributes:
        figure: of the paper, None if it has none.
        title: what moves.
        joint: index.
        poses: `[P, nq]` positions of all joints, rad or m.
    """

    figure: int | None
    title: str
    joint: int
    poses: NDArray[np.float64]


FIGURES: dict[str, dict[str, tuple[int, str]]] = {
    "pendulum": {"hinge": (8, "pole turns")},
    "cartpole": {"hinge_1": (9, "pole turns, cart at rest"), "slider": (10, "cart moves, pole hangs")},
    "acrobot": {"shoulder": (11, "both links turn as one"), "elbow": (12, "second link turns, the first hangs")},
}
"""The paper's, by system and joint, in the order of its figures, and what moves there."""


def sweeps_of(system: System) -> list[Sweep]:
    """One per joint, the paper's figures in their order, then others."""
    figures, names = FIGURES.get(system.name, {}), [joint.name for joint in system.joints]
    out = []
    for name in (*figures, *(n for n in names if n not in figures)):
        j = names.index(name)
        poses = np.tile(system.hanging_qpos, (POINTS, 1))
        poses[:, j] = np.linspace(*system.joints[j].start_range, POINTS)
        out.append(Sweep(*figures.get(name, (None, f"{name} moves")), j, poses))
    return out


def potential(model: WorldModel, system: str) -> list[dict[str, Any]]:
    """V at the keypoints of rendered poses, and the true one, in its own scale (one for all sweeps) and offset.

    R² of the sweep of the cart says nothing, for the true potential is constant there; in its place stands how much V
    changes, relative to its range in the other sweep. "unit" is the scale, joules per learned unit of V.
    """
    sweeps, true, learned = sweeps_of(get_system(system)), [], []
    with closing(KeyCLDEnv(system)) as env:
        data = mujoco.MjData(env.model)
        for sweep in sweeps:
            learned.append(model.potential_energy(model.keypoints(np.stack([env.render_qpos(q) for q in sweep.poses]))))
            true.append(np.array([energy(env.model, data, q)[1] for q in sweep.poses]))
    scale = _scale(learned, true)
    widest = max(np.ptp(t) for t in true)
    out = []
    for sweep, v, t in zip(sweeps, learned, true, strict=True):
        scaled = scale * (v - v.mean()) + t.mean()
        flat = np.ptp(t) < 1e-6 * widest
        out.append(
            {
                "figure": sweep.figure,
                "title": sweep.title,
                "position": sweep.poses[:, sweep.joint].tolist(),
                "learned": scaled.tolist(),
                "true": t.tolist(),
                "r2": None if flat else 1 - float(np.sum((scaled - t) ** 2) / np.sum((t - t.mean()) ** 2)),
                "r2_own_scale": None if flat else float(np.corrcoef(v, t)[0, 1] ** 2),
                "change": float(np.ptp(scaled) / widest),
                "unit": scale,
            }
        )
    return out


def _scale(learned: list[NDArray[np.floating]], true: list[NDArray[np.float64]]) -> float:
    """Of all sweeps together, each about its mean."""
    v = np.concatenate([v - v.mean() for v in learned])
    t = np.concatenate([t - t.mean() for t in true])
    return float(v @ t / (v @ v))
