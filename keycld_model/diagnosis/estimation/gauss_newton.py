"""Gauss-Newton steps with damping (Levenberg and Marquardt), initial states eliminated.

Shared parameters are nuisances, parameters of effects, and hidden states at the starts of recordings. Each window has
an initial state of its own, which is fitted exactly to every step of the shared parameters, to first order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import huber

from keycld_model.diagnosis.estimation.belief import Belief
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.initial_states import improve_worst
from keycld_model.diagnosis.estimation.linearisation import Linearisation
from keycld_model.diagnosis.estimation.parameters import effect_parameters, moved
from keycld_model.diagnosis.estimation.point import Point, mixed
from keycld_model.diagnosis.estimation.problem import Problem

Array = NDArray[np.float64]
SETTLING = 3
"""Times that states are fitted with the same derivatives, after a step of shared parameters that is far from linear."""


def minimise(
    problem: Problem, point: Point, iterations: int = 12, share: float = 0.0, only_states: bool = False
) -> Fit:
    """The best fit near a point.

    Derivatives are used again while steps gain enough with old ones.

    Args:
        problem: what is fitted.
        point: to start from.
        iterations: at most.
        share: of what the start costs above noise, which a step must gain for another one; at least a tenth of a nat.
        only_states: nuisances and effects stay as they are; hidden states at the starts of recordings do not.
    """
    recordings = len(problem.windows.commands)
    if len(point.fitted_recording_spreads) and point.variant.recording_offsets is None:
        offsets = point.recording_offsets(recordings)
        point = replace(point, variant=replace(point.variant, recording_offsets=offsets))
    cost, gain = problem.cost(point), np.inf
    damping = 1e-6 if point.variant.window_offsets is None else 1e-3
    least = max(0.1, share * (cost - problem.expected))
    linear, hessian = None, np.eye(0)
    for _ in range(iterations):
        fresh = linear is None
        if linear is None:
            linear, _ = problem.linearise(point, only_states=only_states)
        else:  # derivatives change little
            linear = replace(linear, residual=problem.residual(point))
        normal = _Normal.of(problem, point, linear, only_states)
        hessian = normal.hessian
        better, damping = _descend(problem, point, cost, normal, linear.states, damping, attempts=5 if fresh else 1)
        if better is None:
            if fresh:
                break
            linear = None
            continue
        new, new_cost = improve_worst(problem, *better) if fresh else better
        before, gain = gain, cost - new_cost
        point, cost, damping = new, new_cost, damping / 10
        if gain < least and fresh:
            break
        if gain < least or (not fresh and gain > 0.2 * before):  # old derivatives will not do for another step
            linear = None
    return Fit(problem, point, cost, hessian)


def learned(fit: Fit) -> Belief:
    """What a fit tells of nuisances and parameters of effects, for other recordings."""
    linear, _ = fit.problem.linearise(fit.point)
    return Belief.of(fit.point.variant, _Normal.of(fit.problem, fit.point, linear, only_states=False).hessian)


@dataclass(frozen=True)
class _Normal:
    """Normal equations of the shared parameters.

    Attributes:
        weighted: the linearisation that they are of, outliers weighted down.
        hessian: `[p, p]`.
        gradient: `[p]` downhill.
        scale: `[p]` what damping is relative to.
    """

    weighted: Linearisation
    hessian: Array
    gradient: Array
    scale: Array

    @classmethod
    def of(cls, problem: Problem, point: Point, linear: Linearisation, only_states: bool) -> "_Normal":
        """At a point."""
        n = len(problem.spreads)
        hidden = n + len(effect_parameters(point.effects))
        held = (
            linear if point.variant.window_offsets is None else linear.with_prior(point.offsets, point.offset_spreads)
        )
        weighted = held.weighted(held.huber_weights(problem.criteria.significant))
        shared = weighted.project(weighted.shared)
        residual = weighted.project(weighted.residual[..., None])[..., 0]
        hessian = np.tensordot(shared, shared, axes=([0, 1], [0, 1]))
        gradient = np.tensordot(shared, residual, axes=([0, 1], [0, 1]))
        if (belief := problem.belief) is None:
            hessian[np.arange(n), np.arange(n)] += problem.spreads**-2
            gradient[:n] -= point.variant.values / problem.spreads**2
        else:
            hessian[:hidden, :hidden] += belief.precision
            gradient[:hidden] -= belief.precision @ belief.away(point.variant)
        offsets, spread = point.variant.recording_offsets, point.fitted_recording_spreads
        if len(spread) and offsets is not None:
            spread = np.tile(spread, len(offsets))
            hessian[np.arange(hidden, len(hessian)), np.arange(hidden, len(hessian))] += spread**-2
            gradient[hidden:] -= offsets.ravel() / spread**2
        scale = np.diag(hessian) + 1e-9
        if only_states:
            gradient[:hidden], scale[:hidden] = 0.0, scale[:hidden] + 1e12
        return cls(weighted, hessian, gradient, scale)

    def step(self, damping: float) -> Array:
        """Of the shared parameters, `[p]`."""
        damped = self.hessian + np.diag((damping + 1e-9) * self.scale)
        return np.asarray(np.linalg.lstsq(damped, self.gradient, rcond=None)[0], dtype=np.float64)


def _descend(
    problem: Problem, point: Point, cost: float, normal: _Normal, states: Array, damping: float, attempts: int
) -> tuple[tuple[Point, float] | None, float]:
    """A better point and its cost, if one is found with more and more damping; and the damping.

    Where a camera sees positions, and a step is far from linear, states are fitted to it with old derivatives `states`.
    """
    for _ in range(attempts):
        tried = _after(problem, point, normal.weighted, normal.step(damping))
        new, new_cost = _with_best_states(problem, tried)
        if new_cost >= cost and _seen_askew(problem):
            new, new_cost = _with_best_states(problem, [_settled(problem, tried[0], states), new])
        if new_cost < cost:
            return (new, new_cost), damping
        damping = max(damping, 1e-6) * 30
    return None, damping


def _after(problem: Problem, point: Point, linear: Linearisation, step: Array) -> list[Point]:
    """After a step of shared parameters: with states fitted to it, states that only make up for it, and the old."""
    n, parameters, variant = len(problem.spreads), len(effect_parameters(point.effects)), point.variant
    step = step.copy()
    effects, step[n : n + parameters] = moved(point.effects, step[n : n + parameters])
    farthest = problem.criteria.spreads.farthest * problem.spreads
    values = np.clip(variant.values + step[:n], -farthest, farthest)
    step[:n] = values - variant.values
    offsets = variant.recording_offsets
    if offsets is not None and variant.window_offsets is None:
        offsets = offsets + step[n + parameters :].reshape(offsets.shape)
    after = replace(point, variant=replace(variant, values=values, effects=effects, recording_offsets=offsets))
    change = -linear.shared @ step
    right = np.stack([linear.residual + change, change], axis=-1)
    moves = _state_moves(linear.states, right)
    return [after.moved(move) for move in (moves[..., 0], moves[..., 1], np.zeros_like(moves[..., 0]))]


def _seen_askew(problem: Problem) -> bool:
    """Whether positions may be off by what they are, as those that a camera sees."""
    return any(nuisance.kind != "zero" for nuisance in problem.windows.observation.nuisances)


def _settled(problem: Problem, point: Point, states: Array) -> Point:
    """With states that make up for what they leave, by derivatives `[W, r, s]`.

    An error of a camera that goes with the square of a position moves a cart far, whose place no force tells.
    """
    for _ in range(SETTLING):
        point = point.moved(_state_moves(states, problem.residual(point)[..., None])[..., 0])
    return point


def _state_moves(states: Array, left: Array) -> Array:
    """Of each window, moves `[W, s, k]` of states with derivatives `[W, r, s]` that make up for `[W, r, k]`."""
    return np.stack([np.linalg.lstsq(a, b, rcond=1e-10)[0] for a, b in zip(states, left, strict=True)])


def _with_best_states(problem: Problem, points: Sequence[Point]) -> tuple[Point, float]:
    """The best of each window's states, all of the same shared parameters; and the cost."""
    costs = huber(problem.criteria.significant, problem.residual(*points)).sum(axis=-1)
    costs = costs + np.stack([p.offset_costs() for p in points])
    best = points[0]
    for i, point in enumerate(points[1:], 1):
        best = mixed((costs[i] < costs[:i].min(axis=0))[:, None], point, best)
    return best, float(costs.min(axis=0).sum()) + problem.prior(best)
