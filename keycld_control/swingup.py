"""Many episodes, and how many of them end at the target."""

import functools
import statistics
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

from scipy import stats

from keycld_control.closed_loop import Episode, Loop, LoopSettings, make_loop, run_episode
from keycld_envs.errors import InputError
from keycld_envs.progress import progress
from keycld_envs.workers import map_in_processes

CONFIDENCE = 0.95


@dataclass(frozen=True)
class SwingUpResult:
    """Statistics of a series of episodes.

    Attributes:
        system: environment id.
        start: "random" or "hanging".
        episodes: number of episodes.
        successes: how many ended with a full second at the target.
        interval: 95 % confidence interval of the probability of success (Clopper-Pearson).
        median_time_to_upright_s: median time from which on the mechanism stayed at the target, failures counted as
            infinite.
        mean_return: mean sum of rewards.
        act_per_second: calls of `act` per second; simulation and rendering are not counted.
        seed: seed of the first episode.
        weights: name or path, as asked for.
    """

    system: str
    start: str
    episodes: int
    successes: int
    interval: tuple[float, float]
    median_time_to_upright_s: float
    mean_return: float
    act_per_second: float
    seed: int
    weights: str


def swing_up(settings: LoopSettings, episodes: int, workers: int = 1) -> SwingUpResult:
    """Run episodes with consecutive seeds. Only the timing depends on `workers`.

    Args:
        settings: what to run.
        episodes: how many episodes.
        workers: number of processes.

    Raises:
        InputError: if a setting cannot be used, or the weights are missing, damaged, or of another system.
    """
    if episodes < 1 or workers < 1:
        raise InputError(f"episodes is {episodes} and workers is {workers}; both must be at least 1.")
    seeds = range(settings.seed, settings.seed + episodes)
    with ExitStack() as stack:
        loop = stack.enter_context(make_loop(settings))
        env_id, start = loop.env_id, loop.env.start
        if workers == 1:
            runs: Iterator[Episode] = (run_episode(loop, seed) for seed in seeds)
        else:
            stack.close()  # every worker opens its own
            runs = map_in_processes(functools.partial(_work, settings), seeds, min(workers, episodes))
        done = []
        with progress(f"{env_id} {start}", total=episodes) as advance:
            for episode in runs:
                done.append(episode)
                advance(note=f"{sum(e.success for e in done)} of {len(done)} up")
    return summarise(done, env_id, start, settings)


def summarise(done: list[Episode], env_id: str, start: str, settings: LoopSettings) -> SwingUpResult:
    """Statistics of finished episodes."""
    successes = sum(episode.success for episode in done)
    interval = stats.binomtest(successes, len(done)).proportion_ci(CONFIDENCE, method="exact")
    seconds = sum(episode.act_seconds for episode in done)
    return SwingUpResult(
        system=env_id,
        start=start,
        episodes=len(done),
        successes=successes,
        interval=(round(float(interval.low), 4), round(float(interval.high), 4)),
        median_time_to_upright_s=round(statistics.median(episode.upright_s for episode in done), 3),
        mean_return=round(statistics.fmean(episode.total_reward for episode in done), 2),
        act_per_second=round(sum(episode.act_calls for episode in done) / seconds, 1),
        seed=settings.seed,
        weights=settings.weights or settings.system,
    )


_open = ExitStack()


@functools.cache
def _worker_loop(settings: LoopSettings) -> Loop:
    return _open.enter_context(make_loop(settings))


def _work(settings: LoopSettings, seed: int) -> Episode:
    return run_episode(_worker_loop(settings), seed)
