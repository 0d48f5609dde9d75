"""The Gymnasium environment of every system."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, get_args

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from keycld_envs.checks import ObsType, check_camera, check_choice, check_size, finite_vector, short
from keycld_envs.disturbance import Disturbance, seen
from keycld_envs.effects import Effect
from keycld_envs.errors import InputError
from keycld_envs.rendering import Quality, Renderers
from keycld_envs.simulation import Simulation
from keycld_envs.success import SuccessMonitor
from keycld_envs.systems import Start, System, get_system

RENDER_SIZE = 480
"""Width and height of frames for people, pixels."""


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
    - `action_limit`: symmetric range of every motor; default the system's. `start`: "random" or "hanging".
    - `effects`: physics to add, of `keycld_envs.effects`: friction, springs, lags of motors, and so on.
    - `disturbance`: how the camera differs from the model's, a `keycld_envs.disturbance.Disturbance`.
    - `render_mode`: "rgb_array" or None; `render_width`, `render_height`: of `render`, for people, default 480 x 480.

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
        disturbance: Disturbance | None = None,
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
            disturbance=disturbance,
            render_mode=render_mode,
            render_width=render_width,
            render_height=render_height,
        )
        if not isinstance(system, str | System):
            raise InputError(f"system is {short(system)}; it must be a System, or the short name of one.")
        if not isinstance(effects, Sequence):
            raise InputError(f"effects is {short(effects)}; it must be a list of effects of keycld_envs.effects.")
        if not isinstance(disturbance, Disturbance | None):
            raise InputError(f"disturbance is {short(disturbance)}; it must be a Disturbance, or None.")
        self.system = get_system(system) if isinstance(system, str) else system
        self.obs_type: ObsType = obs_type
        self.width, self.height = check_size("width", width), check_size("height", height)
        self.render_width = check_size("render_width", render_width)
        self.render_height = check_size("render_height", render_height)
        self.render_quality: Quality = render_quality
        self.start: Start = self.system.start if start is None else start
        self.render_mode, self.disturbance, self._noise_seed = render_mode, disturbance, 0
        _check_choices(obs_type, render_quality, self.start, render_mode)
        fps = round(1 / self.system.timestep)
        self.metadata = {**self.metadata, "render_fps": fps}  # pyright: ignore[reportAttributeAccessIssue]
        self._simulation = Simulation(self.system, action_limit, effects)
        self.model, self.data = self._simulation.model, self._simulation.data
        self.camera = check_camera(self.model, self.system.camera if camera is None else camera)
        self._posed = mujoco.MjData(self.model)
        self._renderers = Renderers(self.model, render_quality)
        self._success = SuccessMonitor(self.system, self.model)
        self.action_space = _action_space(self.model)
        self.observation_space = _observation_space(self.model, self.width, self.height)[self.obs_type]

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
        chosen = _chosen_start(options, self.model)
        qpos, qvel = self.system.sample_start(self.start, self.np_random)
        self._simulation.reset(**{"qpos": qpos, "qvel": qvel, **chosen})
        self._success.reset()
        self._noise_seed = 0 if self.disturbance is None else int(self.np_random.integers(2**32))
        return self._observation(), self._info()

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold `action` [m], clipped to the action space, for one control step.

        Returns:
            observation, reward, terminated (never), truncated (left to Gymnasium's TimeLimit), info.

        Raises:
            InputError: if the action has the wrong length or is not finite, or the simulation diverges.
        """
        control = finite_vector("action", action, self.model.nu)
        self._simulation.step(np.clip(control, self.action_space.low, self.action_space.high))
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
        self._renderers.close()

    def _render(self, data: mujoco.MjData, width: int | None = None, height: int | None = None) -> NDArray[np.uint8]:
        size = self.width if width is None else width, self.height if height is None else height
        moment = (self._noise_seed, round(data.time / self.model.opt.timestep))
        return seen(self.disturbance, self._renderers.of_size(*size), data, self.camera, moment)

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


def _check_choices(obs_type: str, render_quality: str, start: str, render_mode: str | None) -> None:
    check_choice("obs_type", obs_type, get_args(ObsType))
    check_choice("render_quality", render_quality, get_args(Quality))
    check_choice("start", start, get_args(Start))
    check_choice("render_mode", render_mode, (None, "rgb_array"))


def _chosen_start(options: Mapping[str, Any] | None, model: mujoco.MjModel) -> dict[str, NDArray[np.float64]]:
    """Positions and velocities that options of `reset` set; with positions alone, the start is at rest."""
    if options is not None and not isinstance(options, Mapping):
        raise InputError(f"reset options must map 'qpos' and 'qvel' to numbers, got {short(options)}.")
    options = options or {}
    sizes = {"qpos": model.nq, "qvel": model.nv}
    if unknown := set(options) - set(sizes):
        raise InputError(f"reset options may have 'qpos' and 'qvel', not {sorted(unknown, key=repr)}.")
    at_rest = {"qvel": np.zeros(model.nv)} if "qpos" in options else {}
    return at_rest | {name: finite_vector(name, options[name], n) for name, n in sizes.items() if name in options}


def _action_space(model: mujoco.MjModel) -> spaces.Box:
    limited = model.actuator_ctrllimited[:, None].astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange, [-np.inf, np.inf]).T.astype(np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def _observation_space(model: mujoco.MjModel, width: int, height: int) -> dict[ObsType, spaces.Space[Any]]:
    pixels = spaces.Box(0, 255, (height, width, 3), np.uint8)
    bound = float(np.finfo(np.float32).max)  # any finite number: Gymnasium warns of infinite bounds
    state = spaces.Box(-bound, bound, (model.nq + model.nv,), np.float64)
    return {"pixels": pixels, "state": state, "pixels_state": spaces.Dict({"pixels": pixels, "state": state})}
