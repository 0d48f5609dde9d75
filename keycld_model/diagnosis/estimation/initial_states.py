"""Better initial states for windows that fit far worse than most: dry friction makes them hard to find."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.point import Point, mixed
from keycld_model.diagnosis.estimation.problem import Problem

Array = NDArray[np.float64]


def improve_worst(problem: Problem, point: Point, cost: float) -> tuple[Point, float]:
    """A point, and its cost, with states of the worst windows fitted one by one.

    Windows count as such that cost three times the median, an eighth of all at most.
    """
    costs = problem.costs(point)
    worst = np.argsort(-costs)[: max(1, len(costs) // 8)]
    bad = np.sort(worst[costs[worst] > 3.0 * np.median(costs)])
    if not len(bad):
        return point, cost
    best, now = _improved(problem.take(bad), point.take(bad), costs[bad])
    everywhere = np.zeros(len(costs), dtype=int)
    everywhere[bad] = np.arange(len(bad))
    chosen = np.isin(np.arange(len(costs)), bad)[:, None]
    return mixed(chosen, best.take(everywhere), point), cost + float((now - costs[bad]).sum())


def _improved(problem: Problem, point: Point, costs: Array) -> tuple[Point, Array]:
    """Points tried elsewhere, then four damped steps of each window's own."""
    q, v = problem.windows.initial_states()
    elsewhere = [*point.elsewhere_in_play(), replace(point, q=q, v=v)]
    damping = np.full(len(costs), 1e-3)
    for attempt in range(len(elsewhere) + 4):
        tried = elsewhere[attempt] if attempt < len(elsewhere) else _step(problem, point, damping)
        then = problem.costs(tried)
        better = (then < costs)[:, None]
        point = mixed(better, tried, point)
        costs, damping = np.minimum(costs, then), np.where(better[:, 0], damping / 5, damping * 10)
    return point, costs


def _step(problem: Problem, point: Point, damping: Array) -> Point:
    """After a step of each window's own states, with a damping of its own, `[W]`."""
    residual, states = problem.linearise_states(point)
    normal = np.einsum("wri,wrj->wij", states, states)
    right = np.einsum("wri,wr->wi", states, residual)
    nv = point.q.shape[1]
    normal[:, 2 * nv :, 2 * nv :] += np.diag(point.offset_spreads**-2)
    right[:, 2 * nv :] -= point.offsets / point.offset_spreads**2
    normal += (damping[:, None] * np.einsum("wii->wi", normal) + 1e-9)[..., None] * np.eye(normal.shape[1])
    return point.moved(np.linalg.solve(normal, right[..., None])[..., 0])
