"""Least squares on trajectories: initial states, nuisances and effects at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect, Parameter
from keycld_envs.effects.base import TransmissionEffect
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.simulator import Simulator, Variant, rotors, unsettled, usual_forces

Array = NDArray[np.float64]
POSITION_STEP, VELOCITY_STEP = 1e-4, 1e-3
"""Steps of derivatives with respect to initial states."""
ATTEMPTS = 5
"""Steps tried, each thirty times more cautious, before the fit counts as converged."""
FAR, SETTLING = 3.0, 4
"""Windows that cost so many times the median get steps of their own for their initial states."""
FARTHEST = 8.0
"""Standard deviations that a nuisance may be off: released mechanisms say nothing of mass and force but their ratio."""
TOLERANCE = 0.1
"""Nats that a step must gain for another one."""
STALE = 0.2
"""Share of the last gain from which on old derivatives are good enough for another step."""
DIVERGED = 1e5
"""Standard deviations that a rollout which diverges is off, and others at most."""
PLACES = (-2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0)
"""Where else in its play a rotor may be, in halves of it."""
JUMP_STEP = 1e-3
"""Step of derivatives with respect to jumps of rotors, in standard deviations expected of them."""
OUTLIER = 4.0
"""Deviation, in standard deviations of the noise, from which the cost of a window's sample grows linearly."""


@dataclass(frozen=True)
class Point:
    """Everything that is fitted.

    Attributes:
        variant: nuisances and effects.
        q: `[W, nv]` initial positions.
        v: `[W, nv]` initial velocities.
    """

    variant: Variant
    q: Array
    v: Array

    def take(self, index: NDArray[np.int64]) -> "Point":
        """Some of the windows."""
        return replace(self, q=self.q[index], v=self.v[index]).jumping(
            None if self.variant.jumps is None else self.variant.jumps[index]
        )

    def jumping(self, jumps: Array | None) -> "Point":
        """With these jumps of rotors at the starts of windows, `[W, J]`."""
        return replace(self, variant=replace(self.variant, jumps=jumps))

    def loosened(self) -> "Point":
        """With rotors that may jump, if there are any."""
        spread = len(_jump_spreads(self.variant.effects))
        return self if self.variant.jumps is not None or not spread else self.jumping(np.zeros((len(self.q), spread)))

    def with_effects(self, *effects: Effect) -> "Point":
        """With these effects instead."""
        return replace(self, variant=self.variant.with_effects(*effects))


@dataclass(frozen=True)
class Knob:
    """One number of one effect."""

    effect: int
    parameter: Parameter


def knobs(effects: Sequence[Effect]) -> list[Knob]:
    """All numbers of effects, in order."""
    return [Knob(i, p) for i, effect in enumerate(effects) for p in effect.parameters()]


def turn(effects: Sequence[Effect], knob: Knob, value: float) -> tuple[Effect, ...]:
    """With one number set."""
    changed: dict[str, Any] = {knob.parameter.name: value}
    return tuple(replace(e, **changed) if i == knob.effect else e for i, e in enumerate(effects))


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals of W windows, and their derivatives.

    Attributes:
        residual: `[W, r]` measured minus predicted over noise; zero where missing.
        states: `[W, r, 2nv + J]` minus its derivative with respect to initial positions, velocities, jumps of rotors.
        shared: `[W, r, p]` the same with respect to nuisances, then the effects' numbers, then what effects remember at
            the start of each recording.
    """

    residual: Array
    states: Array
    shared: Array

    @cached_property
    def basis(self) -> Array:
        """`[W, r, 2nv + J]` orthonormal: what initial states can explain."""
        return np.linalg.qr(self.states)[0]

    def outlier_weights(self) -> Array:
        """`[W, r]`, less than one where the cost grows linearly."""
        return np.sqrt(np.minimum(1.0, OUTLIER / np.maximum(np.abs(self.residual), 1e-9)))

    def weighted(self, weights: Array) -> "Linearisation":
        """With rows weighted, `[W, r]`."""
        column = weights[..., None]
        return Linearisation(self.residual * weights, self.states * column, self.shared * column)

    def anchored(self, jumps: Array, spreads: Array) -> "Linearisation":
        """With J rows more, which hold jumps `[W, J]` near zero."""
        (w, r, n), j, p = self.states.shape, len(spreads), self.shared.shape[2]
        states = np.concatenate([self.states, np.zeros((w, j, n))], axis=1)
        states[:, r:, n - j :] = np.diag(1 / spreads)
        shared = np.concatenate([self.shared, np.zeros((w, j, p))], axis=1)
        return Linearisation(np.concatenate([self.residual, -jumps / spreads], axis=1), states, shared)

    def project(self, columns: Array) -> Array:
        """What initial states cannot explain of columns `[W, r, k]`."""
        return columns - self.basis @ (np.swapaxes(self.basis, 1, 2) @ columns)


@dataclass(frozen=True)
class Problem:
    """Windows of recordings, and what may explain them.

    Attributes:
        simulator: of the mechanism.
        windows: of the recordings.
        noise: `[nv]` standard deviation of the measurement, rad or m.
    """

    simulator: Simulator
    windows: Windows
    noise: Array

    def start(self) -> Point:
        """As believed, from measured initial states."""
        return Point(Variant(np.zeros(len(self.simulator.nuisances))), *self.windows.initial_states())

    def take(self, index: NDArray[np.int64]) -> "Problem":
        """Some of the windows."""
        return Problem(self.simulator, self.windows.take(index), self.noise)

    @property
    def samples(self) -> int:
        """Numbers measured."""
        return int(np.isfinite(self.windows.measured).sum())

    @property
    def expected(self) -> float:
        """Nats that noise alone costs."""
        return 0.5 * (self.samples - 2 * self.windows.measured.shape[2] * len(self.windows))

    @cached_property
    def spreads(self) -> Array:
        """Prior standard deviations of the nuisances."""
        return np.array([n.spread for n in self.simulator.nuisances])

    def residual(self, *points: Point) -> Array:
        """Whitened residuals `[..., W, r]` of one or more points with the same shared numbers.

        A window that diverges counts as `DIVERGED` everywhere.
        """
        q, v = np.stack([p.q for p in points]), np.stack([p.v for p in points])
        variants = [p.variant for p in points] if points[0].variant.jumps is not None else [points[0].variant]
        predicted = self.simulator.simulate(variants, np.arange(len(points)) % len(variants), self.windows, q, v)
        return self.whiten(predicted[0] if len(points) == 1 else predicted)

    def costs(self, point: Point) -> Array:
        """What each window adds to the cost, `[W]`."""
        return _huber(self.residual(point)).sum(axis=-1) + _jump_costs(point)

    def cost(self, point: Point) -> float:
        """Minus the logarithm of the posterior, in nats, up to a constant."""
        return float(self.costs(point).sum()) + self._prior(point)

    def _prior(self, point: Point) -> float:
        starts = 0.0 if point.variant.starts is None else point.variant.starts / unsettled(point.variant.effects)
        return 0.5 * float(np.sum((point.variant.values / self.spreads) ** 2) + np.sum(starts**2))

    def linearise(
        self, point: Point, extra: Sequence[tuple[Effect, ...]] = (), only_starts: bool = False
    ) -> tuple[Linearisation, Array]:
        """Residuals and derivatives at a point.

        Args:
            point: where.
            extra: sets of effects, to be predicted from the same nuisances and initial states.
            only_starts: leave the derivatives to nuisances and effects' numbers at zero.

        Returns:
            The linearisation, and whitened residuals `[len(extra), W, r]` with the extra effects.
        """
        base, n = point.variant, len(self.simulator.nuisances)
        numbers, spread, recordings = knobs(base.effects), _start_spreads(base), len(self.windows.commands)
        variants, columns = [base], []
        for i, nuisance in enumerate(() if only_starts else self.simulator.nuisances):
            if nuisance.kind != "zero":
                values = base.values.copy()
                values[i] += nuisance.scale
                columns.append((i, nuisance.scale))
                variants.append(replace(base, values=values))
        for k, knob in enumerate(() if only_starts else numbers):
            value = getattr(base.effects[knob.effect], knob.parameter.name)
            step = _step(knob.parameter, value, isinstance(base.effects[knob.effect], TransmissionEffect))
            columns.append((n + k, step))
            variants.append(replace(base, effects=turn(base.effects, knob, value + step)))
        for m in range(len(spread)):
            starts = _starts(base, recordings)
            starts[:, m] += 0.1 * spread[m]
            variants.append(replace(base, starts=starts))
        variants += [base.with_effects(*effects) for effects in extra]
        residuals, states = self.roll(variants, point)
        here, known = residuals[0], 1 + len(columns)
        shared = np.zeros((*here.shape, n + len(numbers) + recordings * len(spread)))
        for p, (column, step) in enumerate(columns):
            shared[..., column] = (here - residuals[1 + p]) / step
        for m in range(len(spread)):
            column = (here - residuals[known + m]) / (0.1 * spread[m])
            at = n + len(numbers) + self.windows.recording * len(spread) + m
            shared[np.arange(len(here)), :, at] = column
        measured = np.isfinite(self.windows.measured)
        for i, nuisance in enumerate(() if only_starts else self.simulator.nuisances):
            if nuisance.kind == "zero":
                one = np.zeros(self.windows.measured.shape)
                one[..., nuisance.index] = 1 / self.noise[nuisance.index]
                shared[..., i] = np.where(measured, one, 0.0).reshape(len(here), -1)
        return Linearisation(here, states, shared), residuals[known + len(spread) :]

    def roll(self, variants: Sequence[Variant], point: Point) -> tuple[Array, Array]:
        """Residuals `[V, W, r]` at the point's states, and minus the first's derivative to them, `[W, r, 2nv + J]`."""
        nv, known, jumps = point.q.shape[1], len(variants), variants[0].jumps
        spreads = np.zeros(0) if jumps is None else _jump_spreads(variants[0].effects)
        moved = [replace(variants[0], jumps=jumps + row) for row in JUMP_STEP * np.diag(spreads)]
        which = np.concatenate([np.arange(known), np.zeros(2 * nv, int), known + np.arange(len(moved))])
        q, v = (np.repeat(z[None], len(which), axis=0) for z in (point.q, point.v))
        for j in range(nv):
            q[known + j, :, j] += POSITION_STEP
            v[known + nv + j, :, j] += VELOCITY_STEP
        residuals = self.whiten(self.simulator.simulate([*variants, *moved], which, self.windows, q, v))
        steps = np.concatenate([np.repeat([POSITION_STEP, VELOCITY_STEP], nv), JUMP_STEP * spreads])[:, None, None]
        states = (residuals[0] - residuals[known:]) / steps
        return residuals[:known], np.moveaxis(states, 0, -1)

    def responses(self, point: Point, joints: Sequence[int], bins: int) -> Array:
        """How residuals fall with a push at a joint during one of so many parts of each window.

        Args:
            point: where.
            joints: J of them, among the velocities.
            bins: B parts of a window.

        Returns:
            Change of whitened residuals per N m or N, `[W, r, J, B]`.
        """
        steps, nv = self.windows.steps, point.q.shape[1]
        sizes, edges = usual_forces(self.simulator.model)[list(joints)], self.windows.edges(bins)
        pushes = np.zeros((len(joints), bins, len(self.windows), steps, nv))
        for j, joint in enumerate(joints):
            for b in range(bins):
                pushes[j, b, :, edges[b] : edges[b + 1], joint] = sizes[j]
        pushes = np.concatenate([np.zeros((1, *pushes.shape[2:])), pushes.reshape(-1, *pushes.shape[2:])])
        q, v = (np.repeat(z[None], len(pushes), axis=0) for z in (point.q, point.v))
        which = np.zeros(len(pushes), int)
        here, *pushed = self.whiten(self.simulator.simulate([point.variant], which, self.windows, q, v, pushes))
        columns = (here - np.stack(pushed)).reshape(len(joints), bins, *here.shape) / sizes[:, None, None, None]
        return np.moveaxis(columns, (0, 1), (2, 3))

    def minimise(self, point: Point, iterations: int = 12, share: float = 0.0, only_states: bool = False) -> "Fit":
        """Gauss-Newton with caution, initial states eliminated.

        Args:
            point: to start from.
            iterations: at most.
            share: of what the start costs above noise, which a step must gain for another one; at least `TOLERANCE`.
            only_states: nuisances and effects stay; what these remember at the start of a recording does not.
        """
        variant, recordings = point.variant, len(self.windows.commands)
        spread = np.tile(_start_spreads(variant), recordings)
        if len(spread) and variant.starts is None:
            point = replace(point, variant=replace(variant, starts=_starts(variant, recordings)))
        cost, caution, gain = self.cost(point), 1e-6 if variant.jumps is None else 1e-3, np.inf
        tolerance = max(TOLERANCE, share * (cost - self.expected))
        linear, fresh, n = None, False, len(self.spreads)
        begun = n + len(knobs(variant.effects))
        hessian = np.eye(0)
        for _ in range(iterations):
            if linear is None:
                (linear, _), fresh = self.linearise(point, only_starts=only_states), True
            else:  # derivatives change little
                linear, fresh = replace(linear, residual=self.residual(point)), False
            jumps = point.variant.jumps
            held = linear if jumps is None else linear.anchored(jumps, _jump_spreads(variant.effects))
            weighted = held.weighted(held.outlier_weights())
            shared = weighted.project(weighted.shared)
            residual = weighted.project(weighted.residual[..., None])[..., 0]
            hessian = np.tensordot(shared, shared, axes=([0, 1], [0, 1]))
            gradient = np.tensordot(shared, residual, axes=([0, 1], [0, 1]))
            hessian[np.arange(n), np.arange(n)] += self.spreads**-2
            gradient[:n] -= point.variant.values / self.spreads**2
            if len(spread):
                assert point.variant.starts is not None
                hessian[np.arange(begun, len(hessian)), np.arange(begun, len(hessian))] += spread**-2
                gradient[begun:] -= point.variant.starts.ravel() / spread**2
            scale = np.diag(hessian) + 1e-9
            if only_states:
                gradient[:begun], scale[:begun] = 0.0, scale[:begun] + 1e12
            for _ in range(ATTEMPTS if fresh else 1):
                step = np.asarray(
                    np.linalg.lstsq(hessian + np.diag((caution + 1e-9) * scale), gradient, rcond=None)[0],
                    dtype=np.float64,
                )
                new, new_cost = self._best_states(self._moved(point, weighted, step))
                if new_cost < cost:
                    break
                caution = max(caution, 1e-6) * 30
            else:
                if fresh:
                    break
                linear = None
                continue
            if fresh:
                new, new_cost = self._settled(new, new_cost)
            before, gain = gain, cost - new_cost
            point, cost, caution = new, new_cost, caution / 10
            if gain < tolerance and fresh:
                break
            if gain < tolerance or (not fresh and gain > STALE * before):
                linear = None
        return Fit(self, point, cost, hessian)

    def _moved(self, point: Point, linear: Linearisation, step: Array) -> list[Point]:
        """After a step of shared numbers: with states fitted to it, states that only make up for it, and the old."""
        n, nv = len(self.spreads), point.q.shape[1]
        effects = list(point.variant.effects)
        step = step.copy()
        for k, knob in enumerate(knobs(effects)):
            old = getattr(effects[knob.effect], knob.parameter.name)
            new = float(np.clip(old + step[n + k], knob.parameter.low, knob.parameter.high))
            step[n + k] = new - old
            effects = list(turn(effects, knob, new))
        values, starts = point.variant.values + step[:n], point.variant.starts
        values = np.clip(values, -FARTHEST * self.spreads, FARTHEST * self.spreads)
        step[:n] = values - point.variant.values
        if starts is not None and point.variant.jumps is None:
            starts = starts + step[n + len(knobs(effects)) :].reshape(starts.shape)
        variant = replace(point.variant, values=values, effects=tuple(effects), starts=starts)
        change = -linear.shared @ step
        right = np.stack([linear.residual + change, change], axis=-1)
        moves = np.stack([np.linalg.lstsq(a, b, rcond=1e-10)[0] for a, b in zip(linear.states, right, strict=True)])
        out = []
        for move in (moves[..., 0], moves[..., 1], np.zeros_like(moves[..., 0])):
            jumps = None if point.variant.jumps is None else point.variant.jumps + move[:, 2 * nv :]
            out.append(Point(variant, point.q + move[:, :nv], point.v + move[:, nv : 2 * nv]).jumping(jumps))
        return out

    def _best_states(self, points: list[Point]) -> tuple[Point, float]:
        """With the best of each window's states, all of the same numbers; and the cost."""
        costs = _huber(self.residual(*points)).sum(axis=-1) + np.stack([_jump_costs(p) for p in points])
        best = points[0]
        for i, point in enumerate(points[1:], 1):
            best = mixed((costs[i] < costs[:i].min(axis=0))[:, None], point, best)
        return best, float(costs.min(axis=0).sum()) + self._prior(best)

    def _settled(self, point: Point, cost: float) -> tuple[Point, float]:
        """With better states for windows that fit far worse than most: dry friction makes them hard to find."""
        costs = self.costs(point)
        worst = np.argsort(-costs)[: max(1, len(costs) // 8)]
        bad = np.sort(worst[costs[worst] > FAR * np.median(costs)])
        if not len(bad):
            return point, cost
        part, best, now = self.take(bad), point.take(bad), costs[bad]
        q, v = part.windows.initial_states()
        elsewhere = [*(best.jumping(jumps) for jumps in _places(best)), replace(best, q=q, v=v)]
        caution = np.full(len(bad), 1e-3)
        for attempt in range(len(elsewhere) + SETTLING):
            tried = elsewhere[attempt] if attempt < len(elsewhere) else part._nudged(best, caution)
            then = part.costs(tried)
            better = (then < now)[:, None]
            best = mixed(better, tried, best)
            now, caution = np.minimum(now, then), np.where(better[:, 0], caution / 5, caution * 10)
        everywhere = np.zeros(len(costs), dtype=int)
        everywhere[bad] = np.arange(len(bad))
        chosen = np.isin(np.arange(len(costs)), bad)[:, None]
        return mixed(chosen, best.take(everywhere), point), cost + float((now - costs[bad]).sum())

    def _nudged(self, point: Point, caution: Array) -> Point:
        """After a step of each window's own states, with a caution of its own, `[W]`."""
        residual, states = self.roll([point.variant], point)
        normal = np.einsum("wri,wrj->wij", states, states)
        right = np.einsum("wri,wr->wi", states, residual[0])
        nv, jumps = point.q.shape[1], point.variant.jumps
        if jumps is not None:
            spreads = _jump_spreads(point.variant.effects)
            normal[:, 2 * nv :, 2 * nv :] += np.diag(spreads**-2)
            right[:, 2 * nv :] -= jumps / spreads**2
        normal += (caution[:, None] * np.einsum("wii->wi", normal) + 1e-9)[..., None] * np.eye(normal.shape[1])
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        moved = replace(point, q=point.q + step[:, :nv], v=point.v + step[:, nv : 2 * nv])
        return moved.jumping(None if jumps is None else jumps + step[:, 2 * nv :])

    def whiten(self, predicted: Array) -> Array:
        """Residuals `[..., W, r]` of predictions `[..., W, n, nv]`."""
        deviation = (self.windows.measured - predicted) / self.noise
        deviation = np.where(np.isfinite(predicted), deviation, DIVERGED)
        deviation = np.where(np.isfinite(self.windows.measured), deviation, 0.0)
        return np.clip(deviation, -DIVERGED, DIVERGED).reshape(*predicted.shape[:-2], -1)


@dataclass(frozen=True)
class Fit:
    """The best point that was found.

    Attributes:
        problem: what was fitted.
        point: nuisances, effects and initial states.
        cost: nats.
        hessian: `[p, p]` of the shared numbers, initial states eliminated.
    """

    problem: Problem
    point: Point
    cost: float
    hessian: Array

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What was added."""
        return self.point.variant.effects

    @cached_property
    def chi_square(self) -> float:
        """Mean square of the whitened residuals per degree of freedom; one if only noise is left."""
        residual = self.problem.residual(self.point)
        jumps = self.point.variant.jumps
        used = self.point.q.size * 2 + len(self.hessian) + (0 if jumps is None else jumps.size)
        return float(np.sum(residual**2) / max(1, self.problem.samples - used))

    @cached_property
    def excess(self) -> float:
        """Nats above what noise alone costs."""
        return self.cost - self.problem.expected

    def worth(self, effect: Effect) -> float:
        """Nats that the fit would lose without one of its effects, were it linear in its numbers."""
        at = [
            len(self.problem.spreads) + i for i, k in enumerate(knobs(self.effects)) if self.effects[k.effect] is effect
        ]
        away = np.array([getattr(effect, p.name) - p.absent for p in effect.parameters()])
        away[[bool(p.grid) for p in effect.parameters()]] = 0.0
        covariance = np.linalg.pinv(self.hessian)[np.ix_(at, at)]
        return 0.5 * float(away @ np.linalg.pinv(covariance) @ away)

    def deviations(self) -> Array:
        """Standard deviations of the effects' numbers, in the order of `knobs`."""
        covariance, n = np.linalg.pinv(self.hessian), len(self.problem.spreads)
        return np.sqrt(np.maximum(np.diag(covariance)[n : n + len(knobs(self.effects))], 0))


def mixed(first: NDArray[np.bool_], one: Point, other: Point) -> Point:
    """States of windows from one point where `first`, `[W, 1]`, and from another elsewhere, whose numbers it has."""
    a, b = one.variant.jumps, other.variant.jumps
    jumps = None if a is None or b is None else np.where(first, a, b)
    return replace(other, q=np.where(first, one.q, other.q), v=np.where(first, one.v, other.v)).jumping(jumps)


def _places(point: Point) -> list[Array]:
    """Jumps `[W, J]` that put rotors elsewhere in their play."""
    out, jumps, at = [], point.variant.jumps, 0
    for effect in rotors(point.variant.effects) if jumps is not None else ():
        for share in PLACES:
            moved = np.array(jumps)
            moved[:, at] += share * effect.play
            out += [moved] * (effect.play > 0)
        at += effect.memory
    return out


def _jump_spreads(effects: Sequence[Effect]) -> Array:
    """Standard deviations expected of jumps of rotors, `[J]`."""
    return np.array([spread for effect in rotors(effects) for spread in effect.unsettled])


def _jump_costs(point: Point) -> Array:
    """What each window's jumps cost, `[W]`."""
    if point.variant.jumps is None:
        return np.zeros(len(point.q))
    return 0.5 * np.sum((point.variant.jumps / _jump_spreads(point.variant.effects)) ** 2, axis=1)


def _start_spreads(variant: Variant) -> Array:
    """Standard deviations of what is fitted of the starts of recordings, `[M]`: nothing where rotors may jump."""
    return unsettled(variant.effects) if variant.jumps is None else np.zeros(0)


def _starts(variant: Variant, recordings: int) -> Array:
    """What effects remember at the start of each recording, `[R, M]`, a copy."""
    none = np.zeros((recordings, len(unsettled(variant.effects))))
    return none if variant.starts is None else variant.starts.copy()


def _step(parameter: Parameter, value: float, short: bool) -> float:
    """Of a derivative; inwards where the bound is near; `short` for rotors, which swing fast."""
    step = (0.001 if short else 0.02) * max(0.1 * parameter.scale, abs(value) * 0.5)
    return -step if value + step > parameter.high else step


def _huber(z: Array) -> Array:
    size = np.abs(z)
    return np.where(size < OUTLIER, 0.5 * z**2, OUTLIER * (size - 0.5 * OUTLIER))
