"""Times and forces of pulses, refined in the windows that they are in."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.linearisation import Linearisation
from keycld_model.diagnosis.estimation.point import Point, mixed
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.variant import Pulse

Array = NDArray[np.float64]


def refine_times(problem: Problem, point: Point) -> Point:
    """Forces and times of pulses after a few damped steps, initial states eliminated."""
    windows, pulses = problem.windows, list(point.variant.pulses)
    touched = [_touched(windows, p) for p in pulses]
    together = _together(touched, len(windows))
    damping, costs = np.full(len(pulses), 1e-2), problem.costs(point)
    for _ in range(6):
        proposal = _proposed(problem, point, touched, damping)
        tried = minimise(problem, point.with_pulses(*proposal), 2, only_states=True).point
        new_costs = problem.costs(tried)
        gains = np.bincount(together, costs - new_costs, len(windows))
        better = gains[together] > 0
        chosen = np.array([better[w[0]] for w in touched])
        pulses = [n if yes else p for n, p, yes in zip(proposal, pulses, chosen, strict=True)]
        damping = np.where(chosen, damping / 5, damping * 10)
        point = mixed(better[:, None], tried, point.with_pulses(*pulses))
        costs = np.where(better, new_costs, costs)
    return point


def _proposed(problem: Problem, point: Point, touched: Sequence[NDArray[np.int64]], damping: Array) -> list[Pulse]:
    """Each pulse after a Gauss-Newton step of its own, in the windows that it is in."""
    windows, pulses, step = problem.windows, point.variant.pulses, problem.windows.step
    base, states = problem.linearise_states(point)
    columns = []
    for name, amount in (("force", None), ("start", 0.2 * step), ("duration", 0.2 * step)):
        sizes = np.array([amount or 0.02 * abs(p.force) + 1e-6 for p in pulses])
        shifted = [replace(p, **{name: getattr(p, name) + d}) for p, d in zip(pulses, sizes, strict=True)]
        columns.append((base - problem.residual(point.with_pulses(*shifted)), sizes))
    linear = Linearisation(base, states, np.stack([change for change, _ in columns], axis=-1))
    shared, residual = linear.project(linear.shared), linear.project(linear.residual[..., None])[..., 0]
    out = []
    for i, (p, w) in enumerate(zip(pulses, touched, strict=True)):
        jacobian = shared[w].reshape(-1, 3) / np.array([sizes[i] for _, sizes in columns])
        normal = jacobian.T @ jacobian
        normal += np.diag((damping[i] + 1e-9) * np.diag(normal) + 1e-12)
        change = np.linalg.solve(normal, jacobian.T @ residual[w].ravel())
        end = windows.end[w[-1]]
        start = float(np.clip(p.start + change[1], windows.start[w[0]], end - step))
        duration = float(np.clip(p.duration + change[2], step, max(step, end - start)))
        out.append(replace(p, force=p.force + float(change[0]), start=start, duration=duration))
    return out


def _touched(windows: Windows, pulse: Pulse) -> NDArray[np.int64]:
    """Windows that a pulse is in, at least the one in which it begins."""
    if not pulse.rounded:
        return np.array([window_of(windows, pulse)])
    apart = (windows.start >= pulse.start + pulse.duration) | (windows.end <= pulse.start)
    inside = np.flatnonzero((windows.recording == pulse.recording) & ~apart)
    return inside if len(inside) else np.array([window_of(windows, pulse)])


def _together(touched: Sequence[NDArray[np.int64]], windows: int) -> NDArray[np.int64]:
    """A number for each window, the same for windows that have a pulse in common."""
    out = np.arange(windows)
    for some in touched:
        out[np.isin(out, out[some])] = out[some].min()
    return out


def window_of(windows: Windows, pulse: Pulse) -> int:
    """The window in which a pulse began to be looked for."""
    inside = (
        (windows.recording == pulse.recording) & (windows.start <= pulse.start + 1e-9) & (pulse.start < windows.end)
    )
    return int(np.flatnonzero(inside)[-1])
