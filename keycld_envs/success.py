"""When an episode counts as a success."""

import mujoco
import numpy as np

from keycld_envs.systems import System


class SuccessMonitor:
    """Watches whether the mechanism has stayed at its target for long enough.

    At the target, every link is within `tolerance.angle` of its target orientation (measured absolutely, not against
    the previous link), every slide joint within `tolerance.position`, and every joint slower than
    `tolerance.velocity`.

    Args:
        system: gives target configuration and tolerance.
        model: its compiled model.
    """

    def __init__(self, system: System, model: mujoco.MjModel) -> None:
        hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self._tolerance = system.tolerance
        self._min_cosine = np.cos(system.tolerance.angle)
        self._links = model.jnt_bodyid[hinges]
        self._slides = np.flatnonzero(~hinges)
        target = mujoco.MjData(model)
        target.qpos[:] = system.target_qpos
        mujoco.mj_kinematics(model, target)
        self._orientations = target.xmat[self._links].copy()
        self._positions = target.qpos[self._slides].copy()
        self._since = np.inf

    def at_target(self, data: mujoco.MjData) -> bool:
        """Whether the state `data`, with kinematics up to date, is at the target now."""
        # the trace of the rotation between two orientations is 1 + 2 cos(angle between them)
        cosines = (np.einsum("li,li->l", data.xmat[self._links], self._orientations) - 1) / 2
        return bool(
            (cosines >= self._min_cosine).all()
            and (np.abs(data.qpos[self._slides] - self._positions) <= self._tolerance.position).all()
            and (np.abs(data.qvel) < self._tolerance.velocity).all()
        )

    def reset(self) -> None:
        """Forget the past; call at the start of an episode, before `update`."""
        self._since = np.inf

    def update(self, data: mujoco.MjData) -> bool:
        """Take in the next state; returns whether all states of the last `tolerance.duration` s were at the target."""
        self._since = min(self._since, data.time) if self.at_target(data) else np.inf
        return bool(data.time - self._since >= self._tolerance.duration - 1e-9)
