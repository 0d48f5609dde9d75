"""One agent in one environment, from a target image to the end of an episode."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from keycld_control.agent import DEFAULT_KD, DEFAULT_KP, EnergyShapingAgent
from keycld_control.law import Law
from keycld_envs import InputError, KeyCLDEnv, make, resolve_env_id
from keycld_envs.disturbance import Disturbance
from keycld_envs.effects import Effect
from keycld_envs.registration import same_system
from keycld_envs.success import SuccessMonitor
from keycld_envs.systems import Start
from keycld_model import WorldModel

OnStep = Callable[[NDArray[np.uint8], float], None]
"""Called with the image that the agent has just acted on, and the time in s."""


@dataclass(frozen=True)
class LoopSettings:
    """What determines the course of an episode.

    Attributes:
        system: short name or environment id.
        weights: a checkpoint's path, or the name of shipped weights; None takes those of `system`.
        start: "random", "hanging", or None for the environment's own.
        seed: of the first episode; the next one has the next seed.
        action_limit: symmetric limit of the actions; None is the environment's own.
        kp: stiffness, 1/s^2.
        kd: damping, 1/s.
        law: control law, see `EnergyShapingAgent`.
        disturbance: how the camera differs from the one that the model was trained on; None not at all.
        clean_target: the target image is of the camera that the model was trained on, nevertheless.
        effects: physics of the environment that the model has not learned.
        corrections: physics that the agent is told of; in place of what its checkpoint has, if there are any.
    """

    system: str
    weights: str | None = None
    start: Start | None = None
    seed: int = 0
    action_limit: float | None = None
    kp: float = DEFAULT_KP
    kd: float = DEFAULT_KD
    law: Law = "turning"
    disturbance: Disturbance | None = None
    clean_target: bool = False
    effects: tuple[Effect, ...] = ()
    corrections: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; it must be at least 0.")


class Loop(NamedTuple):
    """Environment and agent.

    Attributes:
        env: the bare environment, with pixel observations.
        env_id: its id.
        steps: length of an episode.
        agent: its target is the environment's own, seen by the environment's camera.
    """

    env: KeyCLDEnv
    env_id: str
    steps: int
    agent: EnergyShapingAgent


@dataclass(frozen=True)
class Episode:
    """How one episode went.

    Attributes:
        success: whether the mechanism had stayed at the target for the last second.
        upright_s: time from which on it stayed at the target, s; infinite without success.
        total_reward: the return.
        act_calls: calls of `act` that were timed, all but the first two, which compile.
        act_seconds: their duration together, s.
    """

    success: bool
    upright_s: float
    total_reward: float
    act_calls: int
    act_seconds: float


@contextmanager
def make_loop(settings: LoopSettings) -> Iterator[Loop]:
    """Load the weights, make environment and agent, and close the environment at the end.

    Raises:
        InputError: if a setting cannot be used, or the weights are missing, damaged, or of another system.
    """
    env_id = resolve_env_id(settings.system)
    model = WorldModel.load(settings.weights or settings.system)
    height, width = model.image_shape
    env = make(
        env_id,
        disable_env_checker=True,
        start=settings.start,
        action_limit=settings.action_limit,
        effects=settings.effects,
        width=width,
        height=height,
        disturbance=None if settings.clean_target else settings.disturbance,
    )
    bare = env.unwrapped
    if not isinstance(bare, KeyCLDEnv) or env.spec is None or not env.spec.max_episode_steps:
        raise InputError(f"{env_id} is no KeyCLD environment of finite length; register it with keycld_envs.register.")
    with closing(bare):
        _check_system(model, bare, env_id)
        agent = EnergyShapingAgent(
            model.with_effects(settings.corrections) if settings.corrections else model,
            bare.render_qpos(bare.system.target_qpos),
            settings.kp,
            settings.kd,
            law=settings.law,
            action_space=bare.action_space,
        )
        bare.disturbance = settings.disturbance
        yield Loop(bare, env_id, env.spec.max_episode_steps, agent)


def run_episode(loop: Loop, seed: int, on_step: OnStep | None = None) -> Episode:
    """Run one episode, from reset to truncation.

    Args:
        loop: environment and agent; both are reset.
        seed: of the environment's reset.
        on_step: sees every image after the agent has acted on it.
    """
    env, agent = loop.env, loop.agent
    monitor = SuccessMonitor(env.system, env.model)
    agent.reset()
    frame, info = env.reset(seed=seed)
    up_since, total_reward, calls, seconds = np.inf, 0.0, 0, 0.0
    for step in range(loop.steps):
        begin = time.perf_counter()
        action = agent.act(frame)
        if step >= 2:
            calls, seconds = calls + 1, seconds + time.perf_counter() - begin
        if on_step is not None:
            on_step(frame, step * env.system.timestep)
        frame, reward, _, _, info = env.step(action)
        total_reward += reward
        up_since = min(up_since, env.data.time) if monitor.at_target(env.data) else np.inf
    success = bool(info["is_success"])
    return Episode(success, float(up_since) if success else np.inf, total_reward, calls, seconds)


def _check_system(model: WorldModel, env: KeyCLDEnv, env_id: str) -> None:
    """Refuse the weights of another system."""
    trained = model.system
    same = model.mechanism == env.system.mechanism if trained is None else same_system(trained, env_id)
    if not same:
        raise InputError(
            f"The weights were trained on {trained or 'another mechanism'}, not on {env_id}; name its own."
        )
