"""A system in many configurations, as its camera sees them."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.projection import pose
from keycld_envs.systems import System

SIDE = 64
"""Pixels of the square images in which distances are told."""
PIXEL = 2 / (SIDE - 1)
"""Image units."""
STEP = 1e-6
"""Of joints, for differences."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Keypoints of a system in P configurations.

    Attributes:
        system: the declaration.
        model: its compiled model.
        qpos: [P, nq] rad or m; the last two are the target and `hanging_qpos`.
        keypoints: [P, K, 2] image units.
        depths: [P, K] distance before the camera, m; negative is behind it.
        jacobians: [P, 2K, nv] derivative of the keypoints by the joints, image units per rad or m.
    """

    system: System
    model: mujoco.MjModel
    qpos: NDArray[np.float64]
    keypoints: NDArray[np.float64]
    depths: NDArray[np.float64]
    jacobians: NDArray[np.float64]

    @classmethod
    def of(cls, system: System, model: mujoco.MjModel, number: int, seed: int) -> "Poses":
        """`number` random configurations, uniform over the joints' start ranges, the target, and at rest."""
        rng = np.random.default_rng(seed)
        drawn = [system.sample_start("random", rng)[0] for _ in range(number)]
        qpos = np.array([*drawn, system.target_qpos, system.hanging_qpos], np.float64)
        data = mujoco.MjData(model)
        keypoints, depths, jacobians = zip(*(_seen(system, model, data, each) for each in qpos), strict=True)
        return cls(system, model, qpos, np.array(keypoints), np.array(depths), np.array(jacobians))

    def keypoints_at(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """[P, K, 2] keypoints of other configurations [P, nq], image units."""
        data = mujoco.MjData(self.model)
        return np.array([_keypoints(self.system, self.model, data, each) for each in qpos])

    def named(self, k: int) -> str:
        """What to call a keypoint in a sentence."""
        return f"keypoint {k} (on body {self.system.landmarks[k].body!r})"


def _seen(
    system: System, model: mujoco.MjModel, data: mujoco.MjData, qpos: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Keypoints, depths and Jacobian of one configuration."""
    at, columns = _keypoints(system, model, data, qpos), []
    camera = model.camera(system.camera).id
    forward = -data.cam_xmat[camera].reshape(3, 3)[:, 2]
    depths = (system.keypoint_positions(model, data) - data.cam_xpos[camera]) @ forward
    for joint in range(model.nv):
        moved = qpos.copy()
        moved[joint] += STEP
        columns.append((_keypoints(system, model, data, moved) - at).reshape(-1) / STEP)
    return at, depths, np.stack(columns, axis=1)


def _keypoints(
    system: System, model: mujoco.MjModel, data: mujoco.MjData, qpos: Sequence[float] | NDArray[np.float64]
) -> NDArray[np.float64]:
    pose(model, data, qpos)
    return system.keypoints(model, data, SIDE, SIDE)
