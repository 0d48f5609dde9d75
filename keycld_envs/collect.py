"""Data sets from simulation: many short runs of one environment, drawn in parallel, resumable after a kill."""

import functools
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import mujoco
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray

from keycld_envs import __version__
from keycld_envs.checks import check_number, check_size, check_whole
from keycld_envs.env import KeyCLDEnv
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file, one_writer
from keycld_envs.policies import get_policy
from keycld_envs.progress import progress
from keycld_envs.reading import read_json
from keycld_envs.recordings import Recording, write_recording
from keycld_envs.registration import make, resolve_env_id, spec_of
from keycld_envs.rendering import Quality, describe_camera
from keycld_envs.workers import map_in_processes

PAPER_ACTION_RANGE = 3.0
MOST_ACTION = 1e300
"""Control units; a number that can be doubled."""
SETTINGS_FILE = "collect.json"
Guard = Callable[[NDArray[np.float32], NDArray[np.uint8]], NDArray[np.float32]]
"""(action `[m]` that is about to be taken, last frame) -> action to take instead."""


@dataclass(frozen=True)
class CollectSettings:
    """What determines every pixel of a collected data set, except its number of episodes.

    Attributes:
        env_id: environment id or short name, for instance "KeyCLD/Acrobot-v0", or "my_module:MyLab/Slider-v0" of a
            module of yours; short names become ids.
        steps: frames per episode; frame 0 shows the initial state, and steps - 1 actions are applied.
        policy: name of the excitation, see `keycld_envs.policies`.
        action_range: actions are drawn within ± this bound (control units); None means ±3, the paper's range, or
            the environment's own limits where they are tighter.
        velocity: initial joint velocities are uniform within ± this bound (rad/s, m/s).
        width: frame width, pixels.
        height: frame height, pixels.
        camera: camera name, None for the system's own.
        render_quality: "fast" or "full".
        seed: seed of the data set; episode i depends on it and on i only.
    """

    env_id: str
    steps: int = 50
    policy: str = "constant"
    action_range: float | None = None
    velocity: float = 0.0
    width: int = 64
    height: int = 64
    camera: str | None = None
    render_quality: Quality = "fast"
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "env_id", resolve_env_id(self.env_id))
        get_policy(self.policy)
        for name, least, most in (("steps", 2, 10**9), ("seed", 0, 2**63)):
            check_whole(name, getattr(self, name), least, most)
        check_size("width", self.width)
        check_size("height", self.height)
        check_number("velocity", self.velocity, 0.0, 1e6, inclusive=True)
        if self.action_range is not None:
            check_number("action_range", self.action_range, 0.0, MOST_ACTION)


@dataclass(frozen=True)
class CollectSummary:
    """What a call of `collect` did.

    Attributes:
        system: environment id.
        out: the data set's folder.
        episodes: recordings in the folder now.
        newly_recorded: recordings made by this call.
        already_there: recordings found complete from an earlier call.
        frames_per_second: frames recorded per second of this call, 0 if there was nothing left to do.
    """

    system: str
    out: str
    episodes: int
    newly_recorded: int
    already_there: int
    frames_per_second: float


def collect(out: str | os.PathLike[str], settings: CollectSettings, episodes: int, workers: int = 1) -> CollectSummary:
    """Record `episodes` runs into the folder `out`, keeping those an earlier, interrupted call completed.

    The result does not depend on `workers`, nor on how often the work was interrupted.

    Args:
        out: the data set's folder; created if absent.
        settings: what to record.
        episodes: number of recordings the folder shall hold.
        workers: number of processes (spawned, one renderer each).

    Raises:
        InputError: if the folder was collected with other settings, holds more recordings or something else,
            another process writes to it, an argument is out of range, or no OpenGL is available.
    """
    out = Path(out)
    if episodes < 1 or workers < 1:
        raise InputError(f"episodes is {episodes} and workers is {workers}; both must be at least 1.")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder.")
    with one_writer(out):
        _prepare_folder(out, settings)
        return _complete(out, settings, episodes, workers)


def _complete(out: Path, settings: CollectSettings, episodes: int, workers: int) -> CollectSummary:
    """Record what a prepared folder lacks."""
    complete = {p.name for p in out.iterdir() if p.is_dir() and not p.name.startswith(".")}
    wanted = {episode_id(i): i for i in range(episodes)}
    if extra := complete - wanted.keys():
        raise InputError(
            f"{out} holds {min(extra)} beyond the {episodes} episodes asked for; "
            f"ask for at least {len(complete)} episodes or choose another folder."
        )
    missing = [i for name, i in wanted.items() if name not in complete]
    start = time.perf_counter()
    with progress("Collecting", total=episodes) as advance:
        advance(len(complete))
        for _ in _record_all(out, settings, missing, min(workers, len(missing))):
            advance()
    seconds = time.perf_counter() - start
    rate = len(missing) * settings.steps / seconds if missing else 0.0
    return CollectSummary(settings.env_id, str(out), episodes, len(missing), len(complete), round(rate, 1))


def episode_id(index: int) -> str:
    """Folder name and id of episode `index`."""
    return f"episode-{index:05d}"


def record_episode(env: KeyCLDEnv, settings: CollectSettings, index: int, guard: Guard | None = None) -> Recording:
    """Run and film one episode; the same arguments give the same recording.

    Args:
        env: an environment made by `make_env` from the same settings, or the same with effects.
        settings: what to record.
        index: number of the episode, from 0.
        guard: may overrule actions.
    """
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
    qpos, _ = env.system.sample_start("random", rng)
    qvel = rng.uniform(-settings.velocity, settings.velocity, env.model.nv)
    low, high = env.action_space.low.astype(float), env.action_space.high.astype(float)  # pyright: ignore
    bound = PAPER_ACTION_RANGE if settings.action_range is None else settings.action_range
    low, high = np.maximum(low, -bound), np.minimum(high, bound)
    actions = get_policy(settings.policy)(rng, settings.steps - 1, low, high).astype(np.float32)
    return record_run(env, settings, index, qpos, qvel, actions, f"policy {settings.policy}", guard)


def record_run(
    env: KeyCLDEnv,
    settings: CollectSettings,
    index: int,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    actions: NDArray[np.float32],
    about: str,
    guard: Guard | None = None,
) -> Recording:
    """Run and film one episode of these actions.

    Args:
        env: see `record_episode`.
        settings: the environment's.
        index: number of the episode, from 0.
        qpos: `[nq]` where it begins, rad or m.
        qvel: `[nv]` how fast, rad/s or m/s.
        actions: `[T - 1, m]`; where the guard overrules them, its own are written here.
        about: what is done, for the notes.
        guard: may overrule actions.
    """
    frame, info = env.reset(seed=0, options={"qpos": qpos, "qvel": qvel})
    frames, qpos_log, qvel_log = [frame], [info["qpos"]], [info["qvel"]]
    for action in actions:
        if guard is not None:
            action[:] = guard(action, frames[-1])
        frame, _, _, _, info = env.step(action)
        frames.append(frame)
        qpos_log.append(info["qpos"])
        qvel_log.append(info["qvel"])
    clock = env.system.timestep * np.arange(len(frames), dtype=np.float64)
    hinges = [joint.kind == "hinge" for joint in env.system.joints]
    return Recording(
        id=episode_id(index),
        system=settings.env_id,
        source="simulation",
        joint_names=tuple(joint.name for joint in env.system.joints),
        actuator_names=env.system.actuators,
        units={
            "action": _action_units(env.model),
            "qpos": tuple("rad" if hinge else "m" for hinge in hinges),
            "qvel": tuple("rad/s" if hinge else "m/s" for hinge in hinges),
        },
        camera=describe_camera(env.model, env.data, env.camera, env.width, env.height),
        render_quality=settings.render_quality,
        seed=settings.seed,
        licence="CC0-1.0",
        origin=f"keycld {__version__} collect, mujoco {mujoco.__version__}",
        notes=f"{about}, episode {index}",
        t_action=clock[:-1],
        action=actions.astype(np.float64),
        t_state=clock,
        qpos=np.stack(qpos_log),
        qvel=np.stack(qvel_log),
        t_frame=clock,
        frames=np.stack(frames),
    )


def make_env(settings: CollectSettings) -> KeyCLDEnv:
    """The bare environment that `settings` describe; close it after use."""
    env_id = settings.env_id
    if not _makes_keycld_env(env_id):
        raise InputError(f"{env_id} is no KeyCLD environment; declare it as a keycld_envs.System.")
    env = make(
        env_id,
        disable_env_checker=True,
        width=settings.width,
        height=settings.height,
        camera=settings.camera,
        render_quality=settings.render_quality,
        action_limit=settings.action_range,
    ).unwrapped
    assert isinstance(env, KeyCLDEnv)
    return env


def _makes_keycld_env(env_id: str) -> bool:
    entry_point = spec_of(env_id).entry_point
    creator = load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    return isinstance(creator, type) and issubclass(creator, KeyCLDEnv)


def _action_units(model: mujoco.MjModel) -> tuple[str, ...]:
    """The force or torque of action 1, one per actuator: "4 N", "2 N m"; "control" for one that is no plain motor."""
    units = []
    for i in range(model.nu):
        motor = model.actuator_gainprm[i, 0] == 1 and model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
        on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        slide = on_joint and model.jnt_type[model.actuator_trnid[i, 0]] == mujoco.mjtJoint.mjJNT_SLIDE
        units.append(f"{model.actuator_gear[i, 0]:g} {'N' if slide else 'N m'}" if motor and on_joint else "control")
    return tuple(units)


def action_range_of(folder: Path) -> float | None:
    """The range of motors with which `collect` has recorded a folder, control units; None if nothing was said of it."""
    try:
        found = read_json(folder / SETTINGS_FILE)
    except (OSError, ValueError):
        return None
    value = found.get("action_range") if isinstance(found, dict) else None
    return float(value) if isinstance(value, int | float) and 0 < value <= MOST_ACTION else None


def keep_action_range(folder: Path, out: Path) -> None:
    """Write down for recordings that were made of a folder's with what range of motors these were recorded."""
    if (bound := action_range_of(folder)) is not None:
        with atomic_file(out / SETTINGS_FILE, "w") as file:
            json.dump({"action_range": bound}, file, indent=1)


def _prepare_folder(out: Path, settings: CollectSettings) -> None:
    """Create the folder with its settings, or check that its recordings were made with the same ones."""
    path = out / SETTINGS_FILE
    if all(p.name == SETTINGS_FILE or p.name.startswith(".") for p in out.iterdir()):
        with atomic_file(path, "w") as file:
            json.dump(asdict(settings), file, indent=1)
        return
    try:
        found = read_json(path)
    except (OSError, ValueError):
        found = None
    if not isinstance(found, dict) or "env_id" not in found:
        raise InputError(f"{out} exists and was not made by `keycld collect`; choose another folder.")
    for name, value in asdict(settings).items():
        if name not in found or found[name] != value:
            raise InputError(
                f"{out} was collected with {name}={found.get(name)!r}, not {value!r}; "
                "repeat the same settings to resume, or choose another folder."
            )


def _record_all(out: Path, settings: CollectSettings, indices: list[int], workers: int) -> Iterator[None]:
    """Record the episodes, yielding after each."""
    if workers <= 1:
        with closing(make_env(settings)) as env:
            for index in indices:
                write_recording(out / episode_id(index), record_episode(env, settings, index))
                yield
        return
    yield from map_in_processes(functools.partial(_work, out, settings), indices, workers)


_worker_env = functools.cache(make_env)


def _work(out: Path, settings: CollectSettings, index: int) -> None:
    write_recording(out / episode_id(index), record_episode(_worker_env(settings), settings, index))
