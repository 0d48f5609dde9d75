"""The Gymnasium environment of every system."""

from collections.abc import Mapping
from typing import Any, Literal

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from keycld_envs.errors import InputError
from keycld_envs.rendering import Quality, Renderer
from keycld_envs.systems import Start, System, get_system

ObsType = Literal["pixels", "state", "pixels_state"]


class KeyCLDEnv(gym.Env[Any, NDArray[np.float32]], EzPickle):
    """A planar mechanism from dm_control's suite, or the user's own, seen through a camera."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(
        self,
        system: System | str,
        *,
        obs_type: ObsType = "pixels",
        width: int = 64,
        height: int = 64,
        camera: str | None = None,
        render_quality: Quality = "fast",
        action_limit: float | None = None,
        start: Start | None = None,
        render_mode: str | None = None,
    ) -> None:
        EzPickle.__init__(
            self,
            system=system,
            obs_type=obs_type,
            width=width,
            height=height,
            camera=camera,
            render_quality=render_quality,
            action_limit=action_limit,
            start=start,
            render_mode=render_mode,
        )
        self.system = get_system(system) if isinstance(system, str) else system
        self.model = self.system.compile()
        self.data = mujoco.MjData(self.model)
        self._scratch = mujoco.MjData(self.model)
        self.obs_type: ObsType = obs_type
        self.width, self.height = width, height
        self.camera = camera or self.system.camera
        self.render_quality: Quality = render_quality
        self.start: Start = start or self.system.start
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1 / self.system.timestep)}
        limit = self.system.action_limit if action_limit is None else action_limit
        if limit is not None:
            self.model.actuator_ctrlrange[:] = [-limit, limit]
        low, high = self.model.actuator_ctrlrange.T.astype(np.float32)
        self.action_space = spaces.Box(low, high, dtype=np.float32)
        pixels = spaces.Box(0, 255, (height, width, 3), np.uint8)
        state = spaces.Box(-np.inf, np.inf, (self.model.nq + self.model.nv,), np.float64)
        self.observation_space = {
            "pixels": pixels,
            "state": state,
            "pixels_state": spaces.Dict({"pixels": pixels, "state": state}),
        }[obs_type]
        self._substeps = round(self.system.timestep / self.model.opt.timestep)
        self._renderer: Renderer | None = None
        self._at_target_since = np.inf
        self._target = self._target_pose()

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `options` may give "qpos" [nq] and "qvel" [nv]."""
        super().reset(seed=seed)
        qpos, qvel = self.system.sample_start(self.start, self.np_random)
        options = options or {}
        if "qpos" in options:
            qpos, qvel = np.asarray(options["qpos"]), np.zeros(self.model.nv)
        if "qvel" in options:
            qvel = np.asarray(options["qvel"])
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        self._at_target_since = np.inf
        return self._observation(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold `action` [m] for one control step."""
        self.data.ctrl[:] = action
        for _ in range(self._substeps):
            if self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
                mujoco.mj_step(self.model, self.data)
            else:
                mujoco.mj_step2(self.model, self.data)
            mujoco.mj_step1(self.model, self.data)
        reward = self.system.reward(self.model, self.data) if self.system.reward else float(self._at_target())
        return self._observation(), reward, False, False, self._info()

    def render(self) -> NDArray[np.uint8]:
        """[H, W, 3] image of the current state."""
        return self._render(self.data)

    def render_qpos(self, qpos: ArrayLike) -> NDArray[np.uint8]:
        """[H, W, 3] image of the configuration `qpos` [nq] (rad, m); the state of the environment is untouched."""
        self._scratch.qpos[:] = np.asarray(qpos)
        mujoco.mj_forward(self.model, self._scratch)
        return self._render(self._scratch)

    def keypoints(self) -> NDArray[np.float64]:
        """[K, 2] true keypoints of the current state, image units."""
        return self.system.keypoints(self.model, self.data, self.width, self.height, self.camera)

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _render(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        if self._renderer is None:
            self._renderer = Renderer(self.model, self.width, self.height, self.render_quality)
        return self._renderer.render(data, self.camera)

    def _observation(self) -> Any:
        if self.obs_type == "pixels":
            return self._render(self.data)
        state = np.concatenate([self.data.qpos, self.data.qvel])
        return state if self.obs_type == "state" else {"pixels": self._render(self.data), "state": state}

    def _info(self) -> dict[str, Any]:
        now = self.data.time
        self._at_target_since = min(self._at_target_since, now) if self._at_target() else np.inf
        return {
            "qpos": self.data.qpos.copy(),
            "qvel": self.data.qvel.copy(),
            "energy": float(self.data.energy.sum()),
            "is_success": bool(now - self._at_target_since >= self.system.tolerance.duration - 1e-9),
        }

    def _target_pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        self._scratch.qpos[:] = self.system.target_qpos
        mujoco.mj_forward(self.model, self._scratch)
        self._hinges = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
        self._slides = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
        self._links = self.model.jnt_bodyid[self._hinges]
        return self._scratch.xmat[self._links].copy(), self._scratch.qpos[self._slides].copy()

    def _at_target(self) -> bool:
        rotations, positions = self._target
        tolerance = self.system.tolerance
        cosines = (np.einsum("li,li->l", self.data.xmat[self._links], rotations) - 1) / 2
        return bool(
            np.all(cosines >= np.cos(tolerance.angle))
            and np.all(np.abs(self.data.qpos[self._slides] - positions) <= tolerance.position)
            and np.all(np.abs(self.data.qvel) < tolerance.velocity)
        )
