"""The Gymnasium environment of every system."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, get_args

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from keycld_envs.checks import ObsType, check_action_limit, check_camera, check_choice, check_size, finite_vector, short
from keycld_envs.effects import Effect
from keycld_envs.effects.added_physics import AddedPhysics
from keycld_envs.errors import InputError
from keycld_envs.rendering import Quality, Renderer
from keycld_envs.success import SuccessMonitor
from keycld_envs.systems import Start, System, get_system

RENDER_SIZE = 480
"""Width and height of frames for people, pixels."""
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class KeyCLDEnv(gym.Env[Any, Any], EzPickle):
    """Swing-up of a planar mechanism, seen through a fixed camera.

    ## Description
    Systems that come with the library (`keycld systems` lists them), or a mechanism of your own.

    - `KeyCLD/Pendulum-v0`, `KeyCLD/Cartpole-v0`, `KeyCLD/Acrobot-v0` are the systems of the KeyCLD paper, from
      dm_control's suite: a motor on every joint, no friction, thicker links, a camera at right angles to the plane of
      motion. The same go by `KeyCLD/PendulumFullyActuated-v0` and so on.
    - `KeyCLD/PendulumStock-v0` and so on keep dm_control's motors, limits, damping, and geometry, and step bit for bit
      like dm_control.
    - Your own: declare a `keycld_envs.System` and pass it as `system`, or give it an id with `keycld_envs.register`.

    ## Action Space
    `Box(low, high, (m,), float32)`: the control of each motor, clipped to the box; torque or force is control times
    gear. Actions are held for one control step. `keycld systems` prints motors, gears, default ranges and steps.

    The paper gives the acrobot a range of 3, too weak to lift its links directly: `action_limit=3`.

    ## Observation Space
    - `obs_type="pixels"`: `Box(0, 255, (height, width, 3), uint8)`, RGB, row 0 at the top.
    - `obs_type="state"`: `Box(-3.4e38, 3.4e38, (nq + nv,), float64)`, joint positions (rad, m; hinges unwrapped, 0 is
      upright) and joint velocities (rad/s, m/s).
    - `obs_type="pixels_state"`: a `Dict` of both, keys "pixels" and "state".

    ## Rewards
    dm_control's swing-up reward of the same system, between 0 and 1 per step, so that returns compare: `pendulum
    swingup`, `cartpole swingup`, `acrobot swingup`. `info["is_success"]` tells whether for the last 1.0 s every link
    was within 0.2 rad of the target (cart within 0.1 m) and every joint slower than 0.5 rad/s (m/s).

    ## Starting State
    - `start="random"`: angles uniform over the circle, cart uniform in -1 m to 1 m, at rest.
    - `start="hanging"`: hanging down, normal noise of 0.01 on all positions and velocities.

    The default is "random", but "hanging" for CartpoleStock, as in dm_control.
    `reset(options={"qpos": [...], "qvel": [...]})` sets the state exactly; without "qvel" the start is at rest.

    ## Episode End
    Never terminated. Truncated after 1000 steps (`gymnasium.make(..., max_episode_steps=...)`).

    ## Arguments
    - `system`: a `System`, or the short name of one ("acrobot", "acrobot-stock"); given by the id.
    - `obs_type`: "pixels" (default), "state", or "pixels_state".
    - `width`, `height`: size of observed images in pixels, default 64 x 64.
    - `camera`: name of a camera of the model. The default looks at right angles to the plane of motion; in the Stock
      variants, dm_control's own are "fixed" and "lookat" ("lookatcart").
    - `render_quality`: "fast" (default) or "full", which is bit for bit dm_control's image.
    - `action_limit`: symmetric range of every motor; default the system's.
    - `start`: "random" or "hanging".
    - `effects`: physics to add, of `keycld_envs.effects`: friction, springs, lags of motors, and so on.
    - `render_mode`: "rgb_array" or None.
    - `render_width`, `render_height`: size of the frames of `render` in pixels, for people, default 480 x 480.

    `info` holds "qpos" [nq], "qvel" [nv], "energy" (kinetic and potential, J), and "is_success". `model` and `data` are
    the live `MjModel` and `MjData`. OpenGL is opened when the first image is rendered; `close` frees it. Start worker
    processes with "spawn" or "forkserver": OpenGL does not survive a fork.

    ## Version History
    - v0: first version.

    Raises:
        InputError: if an argument, action, or option cannot be used, or no OpenGL library can be loaded.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 50}
    action_space: spaces.Box  # pyright: ignore[reportIncompatibleVariableOverride]

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
        effects: Sequence[Effect] = (),
        render_mode: str | None = None,
        render_width: int = RENDER_SIZE,
        render_height: int = RENDER_SIZE,
    ) -> None:
        EzPickle.__init__(
            self,
            system,
            obs_type=obs_type,
            width=width,
            height=height,
            camera=camera,
            render_quality=render_quality,
            action_limit=action_limit,
            start=start,
            effects=effects,
            render_mode=render_mode,
            render_width=render_width,
            render_height=render_height,
        )
        self._renderers: dict[tuple[int, int], Renderer] = {}
        self.system = get_system(system) if isinstance(system, str) else system
        self.obs_type: ObsType = obs_type
        self.width, self.height = check_size("width", width), check_size("height", height)
        self.render_width = check_size("render_width", render_width)
        self.render_height = check_size("render_height", render_height)
        self.render_quality: Quality = render_quality
        self.start: Start = self.system.start if start is None else start
        self.render_mode = render_mode
        check_choice("obs_type", obs_type, get_args(ObsType))
        check_choice("render_quality", render_quality, get_args(Quality))
        check_choice("start", self.start, get_args(Start))
        check_choice("render_mode", render_mode, (None, "rgb_array"))
        self.metadata = {  # pyright: ignore[reportAttributeAccessIssue]
            **self.metadata,
            "render_fps": round(1 / self.system.timestep),
        }

        self._compile(camera, action_limit, effects)

    def _compile(self, camera: str | None, action_limit: float | None, effects: Sequence[Effect]) -> None:
        self.model = self.system.compile()
        self.data = mujoco.MjData(self.model)
        self.camera = check_camera(self.model, self.system.camera if camera is None else camera)
        limit = self.system.action_limit if action_limit is None else check_action_limit(action_limit)
        if limit is not None:
            self.model.actuator_ctrllimited[:] = True
            self.model.actuator_ctrlrange[:] = [-limit, limit]
        self._effects = AddedPhysics(effects, self.model) if effects else None
        self._posed = mujoco.MjData(self.model)
        self._success = SuccessMonitor(self.system, self.model)
        self._substeps = round(self.system.timestep / self.model.opt.timestep)
        self.action_space = _action_space(self.model)
        self.observation_space = self._observation_space()

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seeds the random starts of this and the following episodes.
            options: "qpos" [nq] (rad, m) sets the configuration, "qvel" [nv] (rad/s, m/s) the velocity.

        Returns:
            observation and info.

        Raises:
            InputError: if an option is unknown, of the wrong length, or not finite.
        """
        super().reset(seed=seed)
        if options is not None and not isinstance(options, Mapping):
            raise InputError(f"reset options must map 'qpos' and 'qvel' to numbers, got {short(options)}.")
        options = options or {}
        if unknown := set(options) - {"qpos", "qvel"}:
            raise InputError(f"reset options may have 'qpos' and 'qvel', not {sorted(unknown, key=repr)}.")
        qpos, qvel = self.system.sample_start(self.start, self.np_random)
        if "qpos" in options:
            qpos, qvel = finite_vector("qpos", options["qpos"], self.model.nq), np.zeros(self.model.nv)
        if "qvel" in options:
            qvel = finite_vector("qvel", options["qvel"], self.model.nv)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        self._success.reset()
        if self._effects:
            self._effects.reset()
        return self._observation(), self._info()

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold `action` [m], clipped to the action space, for one control step.

        Returns:
            observation, reward, terminated (never), truncated (left to Gymnasium's TimeLimit), info.

        Raises:
            InputError: if the action has the wrong length or is not finite, or the simulation diverges.
        """
        control = finite_vector("action", action, self.model.nu)
        np.clip(control, self.action_space.low, self.action_space.high, out=self.data.ctrl)
        for _ in self._effects.steps(self.data, self._substeps) if self._effects else range(self._substeps):
            _physics_step(self.model, self.data)
        if any(self.data.warning[kind].number for kind in _DIVERGED):  # MuJoCo has reset the simulation
            raise InputError("The simulation diverged; use smaller actions, velocities, or time steps.")
        reward = self.system.reward(self.model, self.data) if self.system.reward else self._success.at_target(self.data)
        return self._observation(), float(reward), False, False, self._info()

    def render(self) -> NDArray[np.uint8]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """[render_height, render_width, 3] RGB image of the current state, for people."""
        return self.render_frame(width=self.render_width, height=self.render_height)

    def render_frame(self, *, width: int | None = None, height: int | None = None) -> NDArray[np.uint8]:
        """[height, width, 3] RGB image of the current state, of the observations' size unless told otherwise."""
        return self._render(self.data, width, height)

    def render_qpos(self, qpos: ArrayLike, *, width: int | None = None, height: int | None = None) -> NDArray[np.uint8]:
        """[height, width, 3] RGB image of the configuration `qpos` [nq] (rad, m), for instance a target image.

        The state of the environment stays as it is.

        Raises:
            InputError: if `qpos` has the wrong length or is not finite.
        """
        self._posed.qpos[:] = finite_vector("qpos", qpos, self.model.nq)
        mujoco.mj_forward(self.model, self._posed)
        return self._render(self._posed, width, height)

    def keypoints(self) -> NDArray[np.float64]:
        """[K, 2] true keypoints of the current state, image units (pixel centres span -1 to 1, y up)."""
        return self.system.keypoints(self.model, self.data, self.width, self.height, self.camera)

    def close(self) -> None:
        """Free the renderers."""
        while self._renderers:
            self._renderers.popitem()[1].close()

    def _render(self, data: mujoco.MjData, width: int | None = None, height: int | None = None) -> NDArray[np.uint8]:
        size = (
            self.width if width is None else check_size("width", width),
            self.height if height is None else check_size("height", height),
        )
        if size not in self._renderers:
            self._renderers[size] = Renderer(self.model, *size, self.render_quality)
        return self._renderers[size].render(data, self.camera)

    def _observation_space(self) -> spaces.Space[Any]:
        pixels = spaces.Box(0, 255, (self.height, self.width, 3), np.uint8)
        bound = float(np.finfo(np.float32).max)  # any finite number: Gymnasium warns of infinite bounds
        state = spaces.Box(-bound, bound, (self.model.nq + self.model.nv,), np.float64)
        both = spaces.Dict({"pixels": pixels, "state": state})
        return {"pixels": pixels, "state": state, "pixels_state": both}[self.obs_type]

    def _observation(self) -> Any:
        if self.obs_type == "pixels":
            return self._render(self.data)
        state = np.concatenate([self.data.qpos, self.data.qvel])
        return state if self.obs_type == "state" else {"pixels": self._render(self.data), "state": state}

    def _info(self) -> dict[str, Any]:
        return {
            "qpos": self.data.qpos.copy(),
            "qvel": self.data.qvel.copy(),
            "energy": float(self.data.energy.sum()),
            "is_success": self._success.update(self.data),
        }


def _action_space(model: mujoco.MjModel) -> spaces.Box:
    limited = model.actuator_ctrllimited[:, None].astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange, [-np.inf, np.inf]).T.astype(np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def _physics_step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """One time step that ends with up-to-date kinematics and energy, in the same order as dm_control."""
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        mujoco.mj_step(model, data)
    else:
        mujoco.mj_step2(model, data)
    mujoco.mj_step1(model, data)
