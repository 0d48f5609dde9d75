"""Pushes from outside at unknown times: found one by one in the windows that they spoil, then timed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.fit import Fit, Linearisation, Point, Problem, mixed
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.simulator import Pulse

Array = NDArray[np.float64]
BINS = 16
"""Times in a window at which a pulse may start and end at first."""
PRICE = 20.0
"""Nats that a pulse must gain: three numbers of its own, and its time and joint were searched for."""
FURTHER = 60.0
"""Nats that pulses at a further joint must gain: short pulses at different joints look alike."""
SPIKES = 2
"""Windows that are no coincidence; of 75 sealed null cases none has two such."""
SPARSE = 0.7
"""Share of windows that pushes may be in; where there are more, it is something else."""
CONTINUED = 5.0
"""Nats that its continuation into the next window must gain."""
JOINED = 12
"""Steps between rectangles that may be parts of one half sine."""
ROUNDS, TIMING = 4, 6
"""Pulses per window at most, and steps in which their times are refined."""


def concentrated(fit: Fit, share: float = 0.4, excess: float = 0.6) -> bool:
    """Most of what a fit leaves above noise is in few windows."""
    above = _above(fit)
    few = above[: max(1, int(share * len(above)))]
    total = np.maximum(above, 0).sum()
    return bool(total > PRICE and np.maximum(few, 0).sum() > excess * total and np.median(above) < 0.5 * above[0])


def spiked(fit: Fit) -> bool:
    """Some windows are left with what a pulse must gain, however little that is among all of them."""
    return bool(np.sum(_above(fit) > PRICE) >= SPIKES)


def _above(fit: Fit) -> Array:
    """Nats that each window leaves above noise, the greatest first."""
    return np.sort(fit.problem.costs(fit.point) - 0.5 * fit.problem.samples / len(fit.problem.windows))[::-1]


def pushed(fit: Fit) -> Fit:
    """With the pulses that explain most: all at one joint, or at several if that is worth their numbers."""
    nv = fit.point.q.shape[1]
    options = [fit, *(with_pulses(fit, [joint]) for joint in range(nv))]
    if nv > 1 and sum(bool(f.point.variant.pulses) for f in options) > 1:
        options.append(with_pulses(fit))
    return min(options, key=lambda fit: fit.cost + paid(fit.point.variant.pulses))


def paid(pulses: Sequence[Pulse]) -> float:
    """Nats that pulses must gain together: each has a price, and so has each further joint."""
    return PRICE * len(pulses) + FURTHER * max(0, len({p.dof for p in pulses}) - 1)


def with_pulses(fit: Fit, joints: Sequence[int] | None = None, only_states: bool = False) -> Fit:
    """A fit with the pulses that its windows show, at some joints or at any; without any if there are none.

    With `only_states`, nuisances and effects stay as they are.
    """
    problem, nv = fit.problem, fit.point.q.shape[1]
    joints = range(nv) if joints is None else joints
    point = replace(fit.point, variant=replace(fit.point.variant, pulses=()))
    fit = problem.minimise(point, only_states=True)
    for _ in range(ROUNDS):
        new = _found(fit, list(joints))
        if not new or len({_window(problem.windows, p) for p in new}) > SPARSE * len(problem.windows):
            break
        pulses = (*fit.point.variant.pulses, *new)
        point = replace(fit.point, variant=replace(fit.point.variant, pulses=pulses))
        better = problem.minimise(_timed(problem, point), only_states=only_states)
        if better.cost > fit.cost - PRICE:
            break
        fit = better
    return _rounded(_pruned(fit, only_states), only_states)


def _rounded(fit: Fit, only_states: bool) -> Fit:
    """With half sines instead of rectangles, which may go on in the next window, if that is better."""
    problem, old = fit.problem, fit.point.variant.pulses
    if not old:
        return fit
    pulses = tuple(
        replace(p, rounded=True, force=p.force * np.pi / 2) for p in joined(old, JOINED * problem.windows.step)
    )
    point = replace(fit.point, variant=replace(fit.point.variant, pulses=pulses))
    point = problem.minimise(point, 4, only_states=True).point
    new = problem.minimise(_timed(problem, point), only_states=only_states)
    return new if new.cost + paid(pulses) < fit.cost + paid(old) else fit


def _pruned(fit: Fit, only_states: bool) -> Fit:
    """Without pulses that are not worth their price."""
    problem = fit.problem
    while pulses := fit.point.variant.pulses:
        owner = [_window(problem.windows, p) for p in pulses]
        impulse = [abs(p.force * p.duration) for p in pulses]
        tested = {w: min((i for i in range(len(pulses)) if owner[i] == w), key=impulse.__getitem__) for w in owner}
        weak = set(tested.values())  # of each window, the weakest
        variant = replace(fit.point.variant, pulses=tuple(p for i, p in enumerate(pulses) if i not in weak))
        without = problem.minimise(replace(fit.point, variant=variant), only_states=True)
        loss = problem.costs(without.point) - problem.costs(fit.point)
        drop = {i for i in weak if loss[owner[i]] < PRICE}
        if not drop:
            break
        variant = replace(fit.point.variant, pulses=tuple(p for i, p in enumerate(pulses) if i not in drop))
        fit = problem.minimise(replace(fit.point, variant=variant), only_states=only_states)
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
    columns = problem.responses(fit.point, joints, BINS)
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

    found = {w: pulse(w, int(gain[w].argmax())) for w in map(int, np.flatnonzero(gain.max(axis=1) >= PRICE))}
    for w, first_part in sorted(found.items()):  # a pulse may go on in the window before or after
        for other, edge in ((w - 1, last == BINS), (w + 1, first == 0)):
            if other in found or not 0 <= other < len(windows) or windows.recording[other] != windows.recording[w]:
                continue
            if abs(windows.start[other] - windows.start[w]) > 1.5 * BINS * length[w]:
                continue
            touches = joints.index(first_part.dof) * len(spans) + np.flatnonzero(edge)
            best = int(touches[gain[other, touches].argmax()])
            if gain[other, best] > CONTINUED and force[other, best] * first_part.force > 0:
                found[other] = pulse(other, best)
    return list(found.values())


def _timed(problem: Problem, point: Point) -> Point:
    """Forces and times of pulses refined, each in the windows that it is in, initial states eliminated."""
    windows, pulses = problem.windows, list(point.variant.pulses)
    touched = [_touched(windows, p) for p in pulses]
    together = _together(touched, len(windows))
    step, caution = windows.step, np.full(len(pulses), 1e-2)
    costs = problem.costs(point)
    for _ in range(TIMING):
        base, states = problem.roll([point.variant], point)
        columns = []
        for name, amount in (("force", None), ("start", 0.2 * step), ("duration", 0.2 * step)):
            sizes = np.array([amount or 0.02 * abs(p.force) + 1e-6 for p in pulses])
            moved = tuple(replace(p, **{name: getattr(p, name) + d}) for p, d in zip(pulses, sizes, strict=True))
            shifted = problem.residual(replace(point, variant=replace(point.variant, pulses=moved)))
            columns.append((base[0] - shifted, sizes))
        linear = Linearisation(base[0], states, np.stack([change for change, _ in columns], axis=-1))
        shared, residual = linear.project(linear.shared), linear.project(linear.residual[..., None])[..., 0]
        proposal = list(pulses)
        for i, (p, w) in enumerate(zip(pulses, touched, strict=True)):
            jacobian = shared[w].reshape(-1, 3) / np.array([sizes[i] for _, sizes in columns])
            normal = jacobian.T @ jacobian
            normal += np.diag((caution[i] + 1e-9) * np.diag(normal) + 1e-12)
            change = np.linalg.solve(normal, jacobian.T @ residual[w].ravel())
            end = windows.end[w[-1]]
            start = float(np.clip(p.start + change[1], windows.start[w[0]], end - step))
            duration = float(np.clip(p.duration + change[2], step, max(step, end - start)))
            proposal[i] = replace(p, force=p.force + float(change[0]), start=start, duration=duration)
        tried = replace(point, variant=replace(point.variant, pulses=tuple(proposal)))
        tried = problem.minimise(tried, 2, only_states=True).point
        new_costs = problem.costs(tried)
        gains = np.bincount(together, costs - new_costs, len(windows))
        better = gains[together] > 0
        chosen = np.array([better[w[0]] for w in touched])
        pulses = [n if yes else p for n, p, yes in zip(proposal, pulses, chosen, strict=True)]
        caution = np.where(chosen, caution / 5, caution * 10)
        point = mixed(better[:, None], tried, replace(point, variant=replace(point.variant, pulses=tuple(pulses))))
        costs = np.where(better, new_costs, costs)
    return point


def _touched(windows: Windows, pulse: Pulse) -> NDArray[np.int64]:
    """Windows that a pulse is in, at least the one in which it begins."""
    if not pulse.rounded:
        return np.array([_window(windows, pulse)])
    apart = (windows.start >= pulse.start + pulse.duration) | (windows.end <= pulse.start)
    inside = np.flatnonzero((windows.recording == pulse.recording) & ~apart)
    return inside if len(inside) else np.array([_window(windows, pulse)])


def _together(touched: Sequence[NDArray[np.int64]], windows: int) -> NDArray[np.int64]:
    """A number for each window, the same for windows that have a pulse in common."""
    out = np.arange(windows)
    for some in touched:
        out[np.isin(out, out[some])] = out[some].min()
    return out


def _window(windows: Windows, pulse: Pulse) -> int:
    """The window in which a pulse began to be looked for."""
    inside = (
        (windows.recording == pulse.recording) & (windows.start <= pulse.start + 1e-9) & (pulse.start < windows.end)
    )
    return int(np.flatnonzero(inside)[-1])
