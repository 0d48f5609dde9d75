"""Recordings that show what a mechanism does: safe, and rich enough for a diagnosis, or what one proposed.

Runs are releases from rest and random commands of three strengths. Joint positions are read off every frame by the
world model; a motor whose joint turns too fast, or whose cart leaves the middle of the picture, is told to brake. This
needs no more than the sign of what the motor does.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from keycld_envs import KeyCLDEnv, make
from keycld_envs.collect import CollectSettings, episode_id, record_episode, record_run
from keycld_envs.effects import Effect
from keycld_envs.effects.edited import torque_per_command
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording, read_dataset, write_recording
from keycld_model import WorldModel
from keycld_model.diagnosis.verdict.drive import Drive
from keycld_model.joints import joint_positions

FAST = {"hinge": 10.0, "slide": 2.0}
"""Speeds beyond which motors brake, rad/s and m/s."""
FAR = 1.2
"""Metres from the middle beyond which the motor of a slide pushes back."""
BRAKE = 0.5
"""Share of a motor's range with which it brakes."""
SHARES = (0.0, 0.15, 0.4, 0.8)
"""Of the motors' range, of the commands of one run after the other; none is a release."""
REPEATS = 3
"""Recordings of a proposed experiment, since a diagnosis holds every third one out."""
ASIDE = 0.05
"""Standard deviation of their starts, rad or m: as near as a hand places a mechanism."""
STEPS = 200
"""Frames per run."""
NOISE = 1e-3
"""Standard deviation of measured joint positions, rad or m; fits to positions without any have many optima."""


class Brake:
    """Overrules commands where joints are too fast or too far; see `keycld_envs.collect.Guard`.

    Args:
        model: reads joint positions off frames.
        env: the mechanism.
    """

    def __init__(self, model: WorldModel, env: KeyCLDEnv) -> None:
        points = model.parts.lagrangian(model.parameters).points
        joints = joint_positions(env.system, points)
        self._see = jax.jit(lambda image: joints(points.project(x := model.keypoints_fn(image), 0 * x, 2)[0]))
        self._timestep, self._bound = env.system.timestep, env.action_space.high
        self._pushes = np.sign(torque_per_command(env.model))
        self._turns = np.array([joint.kind == "hinge" for joint in env.system.joints])
        self._fast = np.array([FAST[joint.kind] for joint in env.system.joints])
        self.reset()

    def reset(self) -> None:
        """Forget the last frame, before a run."""
        self._before: NDArray[np.floating] | None = None

    def __call__(self, action: NDArray[np.float32], frame: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The action, or a brake."""
        now = np.asarray(self._see(frame), float)
        change = now - (now if self._before is None else self._before)
        speed = np.where(self._turns, (change + np.pi) % (2 * np.pi) - np.pi, change) / self._timestep
        self._before = now
        against = np.where(np.abs(speed) > self._fast, -np.sign(speed), 0.0)
        far = ~self._turns & (np.abs(now) > FAR) & (now * speed >= 0)
        braking = np.where(far, -np.sign(now), against) @ self._pushes
        return np.where(braking != 0, BRAKE * self._bound * np.sign(braking), action).astype(np.float32)


def explore(
    out: Path, env_id: str, model: WorldModel, effects: Sequence[Effect], recordings: int, seed: int
) -> list[Recording]:
    """Record a mechanism with effects, or read what an earlier call has recorded with the same arguments.

    Args:
        out: folder of recordings.
        env_id: environment.
        model: of the mechanism without effects.
        effects: physics that it has.
        recordings: number of runs.
        seed: of commands and starts; run i depends on it and on i only.
    """
    return _record(out, env_id, model, effects, range(recordings), seed, _run)


def follow(
    out: Path,
    env_id: str,
    model: WorldModel,
    effects: Sequence[Effect],
    experiment: Mapping[str, Any],
    first: int,
    seed: int,
) -> list[Recording]:
    """Record the motion that a diagnosis proposes, a few times from almost the same pose.

    Args:
        out: folder of recordings, which has others.
        env_id: see `explore`.
        model: see `explore`.
        effects: see `explore`.
        experiment: `next_experiment` of a report.
        first: number of the first of these recordings.
        seed: see `explore`.

    Returns:
        All recordings of the folder.
    """

    def run(env: KeyCLDEnv, brake: Brake, settings: CollectSettings, index: int) -> Recording:
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
        start = np.array([experiment["start"][joint.name] for joint in env.system.joints])
        actions = np.zeros((STEPS - 1, env.model.nu), np.float32)
        drive = Drive(**experiment["drive"])
        if drive.shape != "none":
            times = env.system.timestep * np.arange(STEPS - 1, dtype=np.float64)
            actions[:, env.system.actuators.index(experiment["where"]["name"])] = drive.commands(times)
        qpos, guard = start + ASIDE * rng.standard_normal(len(start)), None if drive.shape == "none" else brake
        return record_run(env, settings, index, qpos, np.zeros(env.model.nv), actions, experiment["action"], guard)

    return _record(out, env_id, model, effects, range(first, first + REPEATS), seed, run)


def _record(
    out: Path,
    env_id: str,
    model: WorldModel,
    effects: Sequence[Effect],
    indices: range,
    seed: int,
    run: Callable[[KeyCLDEnv, Brake, CollectSettings, int], Recording],
) -> list[Recording]:
    """Those of the runs that are not there yet; all that are there."""
    height, width = model.image_shape
    settings = CollectSettings(env_id, STEPS, "piecewise", width=width, height=height, seed=seed)
    env = make(env_id, disable_env_checker=True, effects=tuple(effects), width=width, height=height).unwrapped
    assert isinstance(env, KeyCLDEnv)
    with closing(env), progress("Exploring", total=len(indices)) as advance:
        brake = Brake(model, env)
        for index in indices:
            if not (out / episode_id(index)).exists():
                brake.reset()
                write_recording(out / episode_id(index), _measured(run(env, brake, settings, index), seed, index))
            advance()
    return list(read_dataset(out).recordings)


def _run(env: KeyCLDEnv, brake: Brake, settings: CollectSettings, index: int) -> Recording:
    """One run: a release, or commands of one of the strengths."""
    share = SHARES[index % len(SHARES)]
    bound = float(env.action_space.high.max())
    own = replace(settings, policy="piecewise" if share else "release", action_range=share * bound or None)
    return record_episode(env, own, index, brake if share else None)


def _measured(recording: Recording, seed: int, index: int) -> Recording:
    """As encoders would have it."""
    assert recording.qpos is not None
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index, 1)))
    return replace(recording, qpos=recording.qpos + NOISE * rng.standard_normal(recording.qpos.shape), qvel=None)
