"""Figures 8 to 12: potential energy while one joint goes through its range, against the true one."""

from contextlib import closing
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.paper.measures.plant import energy
from keycld_envs import KeyCLDEnv
from keycld_model import WorldModel

POINTS = 73


@dataclass(frozen=True)
class Sweep:
    """One joint through a range, the others at rest.

    Attributes:
        figure: of the paper.
        title: what moves.
        joint: index.
        range: first and last position, rad or m.
        rest: positions of all joints.
    """

    figure: int
    title: str
    joint: int
    range: tuple[float, float]
    rest: tuple[float, ...]

    def poses(self) -> NDArray[np.float64]:
        """`[P, nq]`."""
        poses = np.tile(self.rest, (POINTS, 1))
        poses[:, self.joint] += np.linspace(*self.range, POINTS)
        return poses


TURN = (-np.pi, np.pi)
SWEEPS: dict[str, tuple[Sweep, ...]] = {
    "pendulum": (Sweep(8, "pole turns", 0, TURN, (0.0,)),),
    "cartpole": (
        Sweep(9, "pole turns, cart at rest", 1, TURN, (0.0, 0.0)),
        Sweep(10, "cart moves, pole hangs", 0, (-1.0, 1.0), (0.0, np.pi)),
    ),
    "acrobot": (
        Sweep(11, "both links turn as one", 0, TURN, (0.0, 0.0)),
        Sweep(12, "second link turns, the first hangs", 1, TURN, (np.pi, 0.0)),
    ),
}


def potential(model: WorldModel, system: str) -> list[dict[str, Any]]:
    """V at the keypoints of rendered poses, and the true one, in its own scale (one for all sweeps) and offset.

    R² of the sweep of the cart says nothing, for the true potential is constant there; in its place stands how much V
    changes, relative to its range in the other sweep. "unit" is the scale, joules per learned unit of V.
    """
    sweeps, true, learned = SWEEPS[system], [], []
    with closing(KeyCLDEnv(system)) as env:
        data = mujoco.MjData(env.model)
        for sweep in sweeps:
            poses = sweep.poses()
            learned.append(model.potential_energy(model.keypoints(np.stack([env.render_qpos(q) for q in poses]))))
            true.append(np.array([energy(env.model, data, q)[1] for q in poses]))
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
                "position": sweep.poses()[:, sweep.joint].tolist(),
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
