"""How many episodes end upright, from pixels."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, get_args

from keycld_control.benchmarks.figure import Figure
from keycld_control.benchmarks.weights import Weights
from keycld_control.closed_loop import LoopSettings
from keycld_control.swingup import swing_up
from keycld_envs.systems import Start, get_system


class Case(NamedTuple):
    """One series of episodes; `limit` None is the environment's own."""

    system: str
    limit: float | None
    start: Start
    required: float


STARTS: tuple[Start, ...] = get_args(Start)
REQUIRED, REQUIRED_WEAK = 0.99, 0.95


def cases(systems: Sequence[str]) -> Iterator[Case]:
    """All systems at their default limits, then at their weak ones, of those that have any."""
    for system in systems:
        yield from (Case(system, None, start, REQUIRED) for start in STARTS)
    for system in systems:
        if (limit := get_system(system).weak_limit) is not None:
            yield from (Case(system, limit, start, REQUIRED_WEAK) for start in STARTS)


def swing_up_success(weights: Weights, episodes: int, workers: int = 1, seed: int = 0) -> Iterator[Figure]:
    """Count successes from random and hanging starts, at the default limits, and at a system's weak limit as well.

    Args:
        weights: what to measure.
        episodes: per series.
        workers: number of processes; the counts do not depend on it.
        seed: of the first episode of every series.
    """
    for case in cases(weights.systems):
        settings = LoopSettings(
            case.system, weights.source(case.system), start=case.start, seed=seed, action_limit=case.limit
        )
        result = swing_up(settings, episodes, workers)
        yield Figure(
            measure=f"swing-up, {case.start} start",
            system=case.system if case.limit is None else f"{case.system} ±{case.limit:g}",
            reached=result.successes / episodes,
            required=case.required,
            interval=result.interval,
            count=episodes,
            details={
                "successes": result.successes,
                "median_time_to_upright_s": result.median_time_to_upright_s,
                "mean_return": result.mean_return,
                "first_seed": seed,
            },
        )
