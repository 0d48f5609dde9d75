"""Which effects explain what the refitted simulator cannot: all sets of up to three, scored together."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import EFFECTS, Effect, Parameter
from keycld_model.diagnosis.fit import Fit, Linearisation, Point, Problem, knobs

Array = NDArray[np.float64]
REFINED = {1: 4, 2: 3, 3: 2}
"""Sets of one, two and three effects that are refined a little after each linear scoring."""
GLANCE = 3
"""Gauss-Newton steps of that."""
FINALISTS = 2
"""How many of them are then refined to the end, beside the best of each size."""
ENOUGH, LEAST_SHARE = 500.0, 0.25
"""Nats of misfit that suffice to choose among sets; where there is more, a share of the windows is looked at."""
NOISE = 1.3
"""Variance that a fit may leave, over the sensor's, to count as noise."""
GENTLE = 0.03
"""Rad or m, root mean square over a window, that a probe may move a joint for its effect to count as linear."""
PARTNERS = 40
"""Pairs that are tried with every third effect."""
MATERIAL = 0.005
"""Share of all that a set gains that each of its effects must gain. Named effects are idealised forms, of dry friction
near standstill above all; what gains less may only mend the form of another."""
LOOKED = 6.0
"""Nats that an effect must gain beyond the price of its numbers, for it was looked for among hundreds."""
DOUBTFUL = 100.0
"""Nats below which it is tried whether a fit needs an effect."""
LARGEST = 4
"""Effects at once; where more seem to be needed, the true one is not among them."""
ROUNDS = 4
"""Times that the search starts again from the best set so far."""


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a place, with its nonlinear parameters at one value of their grids.

    Attributes:
        effect: absent: its coefficients are zero.
        coefficients: in which it is linear; empty if it is there or not.
    """

    effect: Effect
    coefficients: tuple[Parameter, ...]

    @property
    def key(self) -> tuple[str, str]:
        """What it is and where."""
        return self.effect.id, self.effect.where

    def probes(self, amount: float = 1.0) -> list[Effect]:
        """The effect a little present, once per coefficient; `amount` of the usual."""
        if not self.coefficients:
            return [self.effect]
        return [replace(self.effect, **{p.name: p.absent + amount * p.scale}) for p in self.coefficients]


def hypotheses(model: mujoco.MjModel, exclude: Iterable[str] = ()) -> list[Hypothesis]:
    """All effects at all places of a model."""
    out = []
    for kind in EFFECTS.values():
        if kind.id in exclude:
            continue
        grids = [p for p in kind.parameters() if p.grid]
        coefficients = tuple(p for p in kind.parameters() if not p.grid)
        for effect in kind.candidates(model):
            for values in itertools.product(*(p.grid for p in grids)):
                chosen = dict(zip((p.name for p in grids), values, strict=True))
                out.append(Hypothesis(replace(effect, **chosen), coefficients))
    return out


def penalty(effects: Sequence[Effect], samples: int) -> float:
    """Nats that a set of effects must gain to be worth its numbers (Schwarz, 1978)."""
    return 0.5 * np.log(samples) * len(knobs(effects))


def misfit(fit: Fit) -> float:
    """Variance of what a fit leaves over the sensor's, times the samples that it is correlated over; one for noise."""
    dof = max(1, fit.problem.samples - 2 * fit.point.q.size - len(fit.hessian))
    left = 2 * fit.cost / dof
    if left < NOISE:
        return 1.0
    residual = fit.problem.residual(fit.point).reshape(fit.problem.windows.measured.shape)
    together, n = 1.0, fit.problem.windows.measured.shape[1]
    for lag in range(1, n // 2):
        rho = float(np.sum(residual[:, lag:] * residual[:, :-lag]) / np.sum(residual**2)) * n / (n - lag)
        if rho < 0.05:
            break
        together += 2 * rho
    return max(1.0, left) * together


@dataclass(frozen=True)
class Scored:
    """A fit, and what it costs with its numbers paid for."""

    fit: Fit
    score: float

    @property
    def numbers(self) -> int:
        """How many the effects have."""
        return len(knobs(self.fit.effects))

    @property
    def keys(self) -> frozenset[tuple[str, str]]:
        """What and where."""
        return frozenset((e.id, e.where) for e in self.fit.effects)


class Search:
    """Finds sets of effects, and remembers all that were refined.

    Attributes:
        found: best fit of each set of effects and places.
        temper: nats of a fit that count as one, because even the best set leaves more than noise.
    """

    def __init__(self, problem: Problem, exclude: Iterable[str] = ()) -> None:
        self.problem = problem
        self.hypotheses = hypotheses(problem.simulator.model, exclude)
        self.found: dict[frozenset[tuple[str, str]], Scored] = {}
        self.temper = 1.0
        self._nothing = np.inf

    def run(self, start: Point) -> Scored:
        """The best set of effects; none if nothing is worth its numbers."""
        best = self._refine(start.with_effects())
        self._nothing = best.score
        for _ in range(ROUNDS):
            better = self._simplified(self._pruned(min([best, *self._finalists(best)], key=_score)))
            if better.score > best.score - self._least(better):
                break
            best = better
        return best

    def soften(self, best: Scored) -> Scored:
        """The best set when gains are measured by what the best set leaves, not by the sensor's noise alone.

        A quasi-likelihood (Burnham and Anderson, 2002, section 2.5): where no set of effects fits down to the noise,
        logarithms of likelihoods are divided by the variance that is left, times the samples over which it is
        correlated; otherwise effects are found that only mend the shape of the misfit. Where only noise is left, this
        changes nothing.
        """
        self.temper = misfit(best.fit)
        if self.temper == 1.0:
            return best
        self.found = {keys: self._scored(s.fit) for keys, s in self.found.items()}
        self._nothing = min((s.score for keys, s in self.found.items() if not keys), default=np.inf)
        return self._pruned(min(self.found.values(), key=_score))

    def _simplified(self, best: Scored) -> Scored:
        """With fewer numbers, if any set found on the way explains materially as much."""
        least = self._least(best)
        fewer = [s for s in self.found.values() if s.numbers < best.numbers and s.score < best.score + 10 * least]
        refined = [self._refine(s.fit.point) for s in sorted(fewer, key=_score)[:FINALISTS]]
        return min([best, *(s for s in refined if s.score < best.score + least)], key=lambda s: (s.numbers, s.score))

    def _least(self, scored: Scored) -> float:
        """Nats that one more effect must gain."""
        return max(LOOKED, MATERIAL * (self._nothing - scored.score))

    def _finalists(self, scored: Scored, largest: int = 3) -> list[Scored]:
        """The most promising sets with one to three more effects."""
        fit = self._sample(scored.fit)
        sets = self._promising(fit, min(largest, LARGEST - len(scored.keys)))
        glances = []
        for effects in sets:
            glance = fit.problem.minimise(fit.point.with_effects(*effects), GLANCE)
            glances.append(Scored(glance, glance.cost + penalty(effects, fit.problem.samples)))
        glances.sort(key=_score)
        sizes = {len(s.fit.effects): s for s in reversed(glances)}  # the best of each
        chosen = {id(s): s for s in (*sizes.values(), *glances[:FINALISTS])}
        return [self._refine(scored.fit.point.with_effects(*s.fit.effects)) for s in chosen.values()]

    def _sample(self, fit: Fit) -> Fit:
        """The fit on a share of the windows, of all degrees of misfit."""
        share = float(np.clip(ENOUGH / max(fit.excess, ENOUGH), LEAST_SHARE, 1.0))
        if share == 1:
            return fit
        order = np.argsort(fit.problem.costs(fit.point))
        index = np.sort(order[np.linspace(0, len(order) - 1, round(share * len(order))).round().astype(int)])
        part, point = fit.problem.take(index), fit.point.take(index)
        return replace(fit, problem=part, point=point, cost=part.cost(point))

    def rivals(self, best: Scored, within: float = 4.0) -> dict[tuple[str, str], list[Scored]]:
        """For each effect of the best set, sets with another in its place that explain as much, within some nats."""
        out = {}
        for effect in best.fit.effects:
            rest = tuple(e for e in best.fit.effects if e is not effect)
            without = self._refine(best.fit.point.with_effects(*rest))
            kept = frozenset((e.id, e.where) for e in rest)
            self._finalists(without, largest=1)
            out[effect.id, effect.where] = [
                s
                for keys, s in self.found.items()
                if kept < keys and len(keys) == len(best.keys) and keys != best.keys and s.score < best.score + within
            ]
        return out

    def _refine(self, point: Point, iterations: int = 12) -> Scored:
        fit = self.problem.minimise(point, iterations)
        scored = self._scored(fit)
        if scored.keys not in self.found or scored.score < self.found[scored.keys].score:
            self.found[scored.keys] = scored
        return scored

    def _scored(self, fit: Fit) -> Scored:
        return Scored(fit, fit.cost / self.temper + penalty(fit.effects, self.problem.samples))

    def _pruned(self, best: Scored) -> Scored:
        """Without effects that are not worth their numbers."""
        while True:
            doubtful = [
                e for e in best.fit.effects if best.fit.worth(e) < self.temper * (DOUBTFUL + 10 * self._least(best))
            ]
            fewer = [
                self._refine(best.fit.point.with_effects(*(e for e in best.fit.effects if e is not effect)))
                for effect in doubtful
            ]
            if not fewer or (least := min(fewer, key=_score)).score > best.score + self._least(best):
                break
            best = least
        return best

    def _promising(self, fit: Fit, largest: int = 3) -> Iterator[tuple[Effect, ...]]:
        """Sets that promise most at a fit's linearisation: its own effects, and up to three more."""
        if largest < 1:
            return
        used = {(e.id, e.where) for e in fit.effects}
        free = [h for h in self.hypotheses if h.key not in used]
        probes = [(i, j, probe) for i, h in enumerate(free) for j, probe in enumerate(h.probes())]
        linear, probed = fit.problem.linearise(fit.point, [(*fit.effects, probe) for *_, probe in probes])
        amounts = self._gentle(linear.residual, probed)
        again = [c for c, (i, _, _) in enumerate(probes) if amounts[c] < 1 and free[i].coefficients]
        if again:
            gentler = [free[probes[c][0]].probes(amounts[c])[probes[c][1]] for c in again]
            probed[again] = fit.problem.linearise(fit.point, [(*fit.effects, probe) for probe in gentler])[1]
        amounts = [amounts[c] if c in set(again) else 1.0 for c in range(len(probes))]
        columns = np.stack(
            [
                (linear.residual - r) / (amount * _amount(free[i], j))
                for (i, j, _), amount, r in zip(probes, amounts, probed, strict=True)
            ],
            axis=-1,
        )
        gram = _Gram(fit.problem, fit, linear, columns)
        members = [[c for c, (i, _, _) in enumerate(probes) if i == h] for h in range(len(free))]
        ranked: dict[frozenset[tuple[str, str]], tuple[float, tuple[Effect, ...]]] = {}
        for chosen in _sets(gram, free, members, fit.problem.samples, largest):
            worth, sizes = chosen.worth, iter(chosen.coefficients)
            effects = tuple(_present(free[h], [next(sizes) for _ in members[h]]) for h in chosen.hypotheses)
            keys = frozenset((e.id, e.where) for e in effects)
            if keys not in ranked or ranked[keys][0] < worth:
                ranked[keys] = worth, effects
        for size, number in REFINED.items():
            best = sorted((item for item in ranked.values() if len(item[1]) == size), key=lambda item: -item[0])
            yield from ((*fit.effects, *effects) for worth, effects in best[:number] if worth > 0)

    def _gentle(self, residual: Array, probed: Array) -> Array:
        """How much of each probe moves no joint by more than `GENTLE`, for residuals `[W, r]` and `[probes, W, r]`."""
        noise = np.tile(self.problem.noise, residual.shape[1] // len(self.problem.noise))
        moved = np.max(np.sqrt(np.mean(((probed - residual) * noise) ** 2, axis=2)), axis=1)
        return np.clip(GENTLE / np.maximum(moved, 1e-12), 1e-4, 1.0)


@dataclass(frozen=True)
class _Chosen:
    worth: float
    hypotheses: tuple[int, ...]
    coefficients: Array


class _Gram:
    """Normal equations of columns after initial states, nuisances and present effects explained what they can."""

    def __init__(self, problem: Problem, fit: Fit, linear: Linearisation, columns: Array) -> None:
        weights = linear.outlier_weights()
        linear, columns = linear.weighted(weights), columns * weights[..., None]
        everything = np.concatenate([linear.shared, columns, linear.residual[..., None]], axis=-1)
        reduced = linear.project(everything)
        full = np.einsum("wri,wrj->ij", reduced, reduced)
        n, p = len(problem.spreads), linear.shared.shape[2]
        full[np.arange(n), np.arange(n)] += problem.spreads**-2
        full[:n, -1] -= fit.point.variant.values / problem.spreads**2
        solved = np.linalg.pinv(full[:p, :p], hermitian=True) @ full[:p, p:]
        left = full[p:, p:] - full[:p, p:].T @ solved
        self.matrix, self.vector = left[:-1, :-1], left[:-1, -1]
        self.own = np.diag(full)[p:-1]  # before others explained what they can

    def gain(self, columns: list[int]) -> tuple[float, Array]:
        """Nats gained by columns, and their coefficients."""
        matrix, vector = self.matrix[np.ix_(columns, columns)], self.vector[columns]
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-12))
        own = np.sqrt(np.maximum(self.own[columns], 1e-12))
        if (scale < 1e-3 * own).any():  # nothing is left of the column
            return 0.0, np.zeros(len(columns))
        regular = matrix / np.outer(scale, scale) + 1e-6 * np.eye(len(columns))
        coefficients = np.linalg.solve(regular, vector / scale) / scale
        return 0.5 * float(vector @ coefficients), coefficients


def _sets(
    gram: _Gram, free: list[Hypothesis], members: list[list[int]], samples: int, largest: int
) -> Iterator[_Chosen]:
    """Admissible sets of hypotheses: all single ones, all pairs, and the best pairs with every third."""

    def evaluate(chosen: tuple[int, ...]) -> _Chosen:
        gain, coefficients = gram.gain([c for h in chosen for c in members[h]])
        sizes = iter(coefficients)
        if not all(_allowed(free[h], [next(sizes) for _ in members[h]]) for h in chosen):
            return _Chosen(-np.inf, chosen, coefficients)
        return _Chosen(gain - penalty([free[h].effect for h in chosen], samples), chosen, coefficients)

    everyone = range(len(free))
    singles = [evaluate((h,)) for h in everyone]
    yield from singles
    if largest < 2:
        return
    pairs = [evaluate((a, b)) for a, b in itertools.combinations(everyone, 2) if free[a].key != free[b].key]
    yield from pairs
    for pair in sorted(pairs, key=lambda c: -c.worth)[:PARTNERS] if largest > 2 else ():
        taken = {free[h].key for h in pair.hypotheses}
        yield from (evaluate((*pair.hypotheses, h)) for h in everyone if free[h].key not in taken)


def _amount(hypothesis: Hypothesis, j: int) -> float:
    return hypothesis.coefficients[j].scale if hypothesis.coefficients else 1.0


def _allowed(hypothesis: Hypothesis, sizes: list[float]) -> bool:
    """Signs are as physics has them."""
    if not hypothesis.coefficients:
        return 0.3 < sizes[0] < 3.0
    return all(p.absent + size >= p.low for p, size in zip(hypothesis.coefficients, sizes, strict=True))


def _present(hypothesis: Hypothesis, sizes: list[float]) -> Effect:
    """The effect with these coefficients."""
    values = {
        p.name: float(np.clip(p.absent + size, p.low, p.high))
        for p, size in zip(hypothesis.coefficients, sizes, strict=False)
    }
    return replace(hypothesis.effect, **values)


def _score(scored: Scored) -> float:
    return scored.score
