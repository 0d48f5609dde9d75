"""Pushes from outside at unknown times: found one by one in the windows that they contaminate, then timed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.pulse_times import refine_times, window_of
from keycld_model.diagnosis.estimation.push_responses import push_responses
from keycld_model.diagnosis.simulation.variant import Pulse

Array = NDArray[np.float64]
BINS = 16
"""Parts of a window at whose edges a pulse may start and end at first."""


def concentrated(fit: Fit, share: float = 0.4, excess: float = 0.6) -> bool:
    """Most of what a fit leaves above noise is in few windows."""
    above = _above(fit)
    few = above[: max(1, int(share * len(above)))]
    total = np.maximum(above, 0).sum()
    return bool(
        total > fit.problem.criteria.pulse
        and np.maximum(few, 0).sum() > excess * total
        and np.median(above) < 0.5 * above[0]
    )


def contaminated(fit: Fit) -> bool:
    """Some windows are left with what a pulse must gain, however little that is among all of them."""
    criteria = fit.problem.criteria
    return bool(np.sum(_above(fit) > criteria.pulse) >= criteria.pulse_windows)


def _above(fit: Fit) -> Array:
    """Nats that each window leaves above noise, the greatest first."""
    return np.sort(fit.problem.costs(fit.point) - 0.5 * fit.problem.samples / len(fit.problem.windows))[::-1]


def with_best_pulses(fit: Fit) -> Fit:
    """A fit with the pulses that explain most: all at one joint, or at several if that is worth their numbers."""
    nv = fit.point.q.shape[1]
    options = [fit, *(with_pulses(fit, [joint]) for joint in range(nv))]
    if nv > 1 and sum(bool(f.point.variant.pulses) for f in options) > 1:
        options.append(with_pulses(fit))
    return min(options, key=paid)


def paid(fit: Fit) -> float:
    """Nats of a fit, with its pulses paid for."""
    return fit.cost + price(fit.point.variant.pulses, fit.problem.criteria)


def price(pulses: Sequence[Pulse], criteria: Criteria) -> float:
    """Nats that pulses must gain together: each has a price.

    A further joint costs as much as three, because short pulses at different joints look alike.
    """
    return criteria.pulse * len(pulses) + 3 * criteria.pulse * max(0, len({p.dof for p in pulses}) - 1)


def with_pulses(fit: Fit, joints: Sequence[int] | None = None, only_states: bool = False) -> Fit:
    """A fit with the pulses that its windows show, at some joints or at any; without any if there are none.

    Masses that make up for strong pushes are wrong where there are none, and pulses seem to be in most windows. So they
    begin in the worst ones; they are none if they are in most of them even then, or leave some unexplained.

    Args:
        fit: without pulses, or with others.
        joints: where they may be.
        only_states: nuisances and effects stay as they are.
    """
    problem, nv = fit.problem, fit.point.q.shape[1]
    joints = range(nv) if joints is None else joints
    before, criteria = minimise(problem, fit.point.with_pulses(), only_states=True), problem.criteria
    fit, most, doubtful = before, int(criteria.pulse_share * len(problem.windows)), False
    for _ in range(4):  # pulses per window at most
        new = _found(fit, list(joints))
        if fit is before:
            new, doubtful = _in_worst_windows(fit, new, most)
        if not new or len(_windows_of(problem, new)) > most:
            break
        point = fit.point.with_pulses(*fit.point.variant.pulses, *new)
        better = minimise(problem, refine_times(problem, point), only_states=only_states)
        if better.cost > fit.cost - criteria.pulse:
            break
        fit = better
    fit = _with_half_sines(_pruned(fit, only_states), only_states)
    everywhere = contaminated(fit) or len(_windows_of(problem, fit.point.variant.pulses)) >= most
    return before if doubtful and everywhere else fit


def _in_worst_windows(fit: Fit, pulses: Sequence[Pulse], most: int) -> tuple[list[Pulse], bool]:
    """Pulses that are in one of so many windows which cost most; and whether there are others."""
    windows, costs = _windows_of(fit.problem, pulses), fit.problem.costs(fit.point)
    worst = sorted(windows, key=lambda window: -costs[window])[:most]
    return [p for p in pulses if window_of(fit.problem.windows, p) in worst], len(windows) > most


def _windows_of(problem: Problem, pulses: Sequence[Pulse]) -> set[int]:
    """Windows in which pulses began to be looked for."""
    return {window_of(problem.windows, p) for p in pulses}


def _with_half_sines(fit: Fit, only_states: bool) -> Fit:
    """With half sines instead of rectangles, which may go on in the next window, if that is better."""
    problem, old = fit.problem, fit.point.variant.pulses
    if not old:
        return fit
    gap, criteria = 12 * problem.windows.step, problem.criteria  # rectangles so near may be parts of one half sine
    pulses = tuple(replace(p, rounded=True, force=p.force * np.pi / 2) for p in joined(old, gap))
    point = minimise(problem, fit.point.with_pulses(*pulses), 4, only_states=True).point
    new = minimise(problem, refine_times(problem, point), only_states=only_states)
    return new if new.cost + price(pulses, criteria) < fit.cost + price(old, criteria) else fit


def _pruned(fit: Fit, only_states: bool) -> Fit:
    """Without pulses that are not worth their price."""
    problem = fit.problem
    while pulses := fit.point.variant.pulses:
        owner = [window_of(problem.windows, p) for p in pulses]
        impulse = [abs(p.force * p.duration) for p in pulses]
        tested = {w: min((i for i in range(len(pulses)) if owner[i] == w), key=impulse.__getitem__) for w in owner}
        weak = set(tested.values())  # of each window, the weakest
        strong = fit.point.with_pulses(*(p for i, p in enumerate(pulses) if i not in weak))
        without = minimise(problem, strong, only_states=True)
        loss = problem.costs(without.point) - problem.costs(fit.point)
        drop = {i for i in weak if loss[owner[i]] < problem.criteria.pulse}
        if not drop:
            break
        kept = fit.point.with_pulses(*(p for i, p in enumerate(pulses) if i not in drop))
        fit = minimise(problem, kept, only_states=only_states)
    return fit


def joined(pulses: Sequence[Pulse], gap: float) -> list[Pulse]:
    """Rectangles of one joint and sense that follow each other within a gap, s, as one."""
    out: list[Pulse] = []
    for p in sorted(pulses, key=lambda p: (p.recording, p.dof, p.start)):
        last = out[-1] if out else None
        same = last is not None and (last.recording, last.dof, last.force > 0) == (p.recording, p.dof, p.force > 0)
        if last is not None and same and not p.rounded and p.start < last.start + last.duration + gap:
            end = max(last.start + last.duration, p.start + p.duration)
            impulse = last.force * last.duration + p.force * p.duration
            out[-1] = replace(last, duration=end - last.start, force=impulse / (end - last.start))
        else:
            out.append(p)
    return out


def _found(fit: Fit, joints: list[int]) -> list[Pulse]:
    """At most one more pulse per window, and its continuation into the next one."""
    problem, windows = fit.problem, fit.problem.windows
    linear, _ = problem.linearise(fit.point)
    columns = push_responses(problem, fit.point, joints, BINS)
    spans = [(a, b) for a in range(BINS) for b in range(a + 1, BINS + 1)]
    total = np.concatenate([np.zeros((*columns.shape[:-1], 1)), np.cumsum(columns, axis=-1)], axis=-1)
    first, last = np.array(spans).T
    flat = linear.project((total[..., last] - total[..., first]).reshape(*linear.residual.shape, -1))
    residual = linear.project(linear.residual[..., None])[..., 0]
    power = np.maximum(np.einsum("wrk,wrk->wk", flat, flat), 1e-9)
    force = np.einsum("wrk,wr->wk", flat, residual) / power
    gain = 0.5 * force**2 * power
    length = (windows.end - windows.start) / BINS

    def pulse(w: int, k: int) -> Pulse:
        (a, b), joint = spans[k % len(spans)], joints[k // len(spans)]
        start, duration = windows.start[w] + a * length[w], (b - a) * length[w]
        return Pulse(int(windows.recording[w]), joint, float(start), float(duration), float(force[w, k]))

    found = {
        w: pulse(w, int(gain[w].argmax())) for w in map(int, np.flatnonzero(gain.max(axis=1) >= problem.criteria.pulse))
    }
    for w, first_part in sorted(found.items()):  # a pulse may go on in the window before or after
        for other, edge in ((w - 1, last == BINS), (w + 1, first == 0)):
            if other in found or not 0 <= other < len(windows) or windows.recording[other] != windows.recording[w]:
                continue
            if abs(windows.start[other] - windows.start[w]) > 1.5 * BINS * length[w]:
                continue
            touches = joints.index(first_part.dof) * len(spans) + np.flatnonzero(edge)
            best = int(touches[gain[other, touches].argmax()])
            if gain[other, best] > problem.criteria.pulse / 4 and force[other, best] * first_part.force > 0:
                found[other] = pulse(other, best)
    return list(found.values())
