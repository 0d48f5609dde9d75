"""How often per second the agent turns an image into an action, on one core."""

import functools
import os
import statistics
import time

from keycld_control.benchmarks.figure import Figure
from keycld_control.benchmarks.weights import Weights
from keycld_envs.progress import progress
from keycld_envs.systems import get_system
from keycld_envs.workers import ONE_THREAD, map_in_processes

REQUIRED = 300.0
IMAGES, REPEATS = 250, 11


def act_per_second(weights: Weights, seed: int = 0, images: int = IMAGES, repeats: int = REPEATS) -> list[Figure]:
    """Time `EnergyShapingAgent.act` in a process that may use one core, and one thread of XLA.

    The images come from an episode of the agent itself, from hanging start to upright: recorded first, then shown
    again and again, so that simulation and rendering take no part.

    Args:
        weights: what to measure.
        seed: of the episode.
        images: images of the episode.
        repeats: how often they are shown; the median counts.
    """
    cases: list[tuple[str, float | None]] = [(system, None) for system in weights.systems]
    cases += [(s, limit) for s in weights.systems if (limit := get_system(s).weak_limit) is not None]  # pump
    work = functools.partial(_measure, weights, seed, images, repeats)
    figures = []
    with progress("Acting on one core", total=len(cases)) as advance:
        for (system, limit), (rates, core) in zip(cases, map_in_processes(work, cases, 1), strict=True):
            figures.append(
                Figure(
                    measure="act/s, one core",
                    system=system if limit is None else f"{system} ±{limit:g}",
                    reached=round(statistics.median(rates), 1),
                    required=REQUIRED,
                    count=repeats,
                    details={"images": images, "slowest": min(rates), "fastest": max(rates), "core": core},
                )
            )
            advance()
    return figures


def _measure(
    weights: Weights, seed: int, images: int, repeats: int, case: tuple[str, float | None]
) -> tuple[list[float], int | None]:
    """Rates of every repeat, and the core; in a process of its own, which has not imported JAX."""
    core = None
    if hasattr(os, "sched_setaffinity"):
        core = max(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {core})
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {ONE_THREAD}".strip()
    os.environ["JAX_PLATFORMS"] = "cpu"

    from keycld_control.closed_loop import LoopSettings, make_loop

    system, limit = case
    settings = LoopSettings(system, weights.source(system), start="hanging", seed=seed, action_limit=limit)
    with make_loop(settings) as loop:
        agent = loop.agent
        image, _ = loop.env.reset(seed=seed)
        episode = [image]
        for _ in range(images - 1):
            image, *_ = loop.env.step(agent.act(episode[-1]))
            episode.append(image)
        rates = []
        for _ in range(repeats):
            agent.reset()
            start = time.perf_counter()
            for image in episode:
                agent.act(image)
            rates.append(round(images / (time.perf_counter() - start), 1))
    return rates, core
