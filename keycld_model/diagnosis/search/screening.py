"""Which sets of effects promise most, to first order: every one, every pair, and the best pairs with every third."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.search.effort import EFFORT
from keycld_model.diagnosis.search.hypotheses import Hypothesis, columns

Array = NDArray[np.float64]


def promising(fit: Fit, free: Sequence[Hypothesis], numbers: Mapping[int, int]) -> Iterator[tuple[Effect, ...]]:
    """Effects of a fit with one to three more, the most promising first.

    Args:
        fit: where effects are linearised.
        free: what may be added.
        numbers: how many sets of each size.
    """
    if not numbers or not free:
        return
    screening, number = _Screening.of(fit, free), len(free)
    sets, worth = np.arange(number)[:, None], np.zeros(number)
    for size in range(1, max(numbers) + 1):
        if size == 2:
            sets = np.stack(np.triu_indices(number, 1), axis=1)
        elif size == 3:
            best = sets[np.argsort(-worth)[: EFFORT.pairs]]
            sets = np.column_stack([np.repeat(best, number, axis=0), np.tile(np.arange(number), len(best))])
        worth, coefficients = screening.evaluate(sets)
        seen: set[frozenset[tuple[str, str]]] = set()
        for i in np.argsort(-worth):
            keys = frozenset(free[h].key for h in sets[i])
            if len(seen) == numbers.get(size, 0) or worth[i] <= 0:
                break
            if keys not in seen:
                seen.add(keys)
                added = (_present(free[h], c) for h, c in zip(sets[i], coefficients[i], strict=True))
                yield (*fit.effects, *added)


@dataclass(frozen=True)
class _Screening:
    """Normal equations of the hypotheses' columns, after initial states, nuisances and present effects.

    Attributes:
        members: `[H, K]` columns of each hypothesis; the last, empty one where it has fewer.
        matrix: `[C + 1, C + 1]`.
        vector: `[C + 1]`.
        own: `[C + 1]` diagonal of the matrix before others explained what they can.
        least: `[H, K]` least coefficients that physics allows.
        most: `[H, K]` greatest.
        price: `[H]` nats that its numbers must gain.
        place: `[H]` number of what it is and where.
    """

    members: NDArray[np.int64]
    matrix: Array
    vector: Array
    own: Array
    least: Array
    most: Array
    price: Array
    place: NDArray[np.int64]

    @classmethod
    def of(cls, fit: Fit, free: Sequence[Hypothesis]) -> "_Screening":
        linear, added, members = columns(fit, free)
        weights = linear.huber_weights(fit.problem.criteria.significant)
        linear, added = linear.weighted(weights), added * weights[..., None]
        everything = linear.project(np.concatenate([linear.shared, added, linear.residual[..., None]], axis=-1))
        flat = everything.reshape(-1, everything.shape[-1])
        full, spreads = flat.T @ flat, fit.problem.spreads
        n, p, c = len(spreads), linear.shared.shape[2], added.shape[2]
        full[np.arange(n), np.arange(n)] += spreads**-2
        full[:n, -1] -= fit.point.variant.values / spreads**2
        solved = np.linalg.pinv(full[:p, :p], hermitian=True) @ full[:p, p:]
        left = full[p:, p:] - full[:p, p:].T @ solved
        matrix, vector, own = np.zeros((c + 1, c + 1)), np.zeros(c + 1), np.ones(c + 1)
        matrix[:c, :c], vector[:c], own[:c] = left[:-1, :-1], left[:-1, -1], np.diag(full)[p:-1]
        matrix[c, c] = 1.0
        most = max(map(len, members))
        places = {key: i for i, key in enumerate(dict.fromkeys(h.key for h in free))}
        bounds = np.full((2, len(free), most), [[[-np.inf]], [[np.inf]]])
        for h, hypothesis in enumerate(free):
            if not hypothesis.coefficients:
                bounds[:, h, 0] = 0.3, 3.0  # it is there or not
            for k, number in enumerate(hypothesis.coefficients):
                bounds[0, h, k] = number.low - number.absent
        return cls(
            np.array([m + [c] * (most - len(m)) for m in members]),
            matrix,
            vector,
            own,
            bounds[0],
            bounds[1],
            0.5 * np.log(fit.problem.samples) * np.array([len(h.effect.parameters()) for h in free]),
            np.array([places[h.key] for h in free]),
        )

    def evaluate(self, sets: NDArray[np.int64]) -> tuple[Array, Array]:
        """Nats gained by sets `[n, size]` with their numbers paid for, and coefficients `[n, size, K]`."""
        n, size = sets.shape
        at = self.members[sets].reshape(n, size * self.members.shape[1])
        empty = at == len(self.vector) - 1
        off = empty[:, :, None] | empty[:, None, :]
        matrix = np.where(off, np.eye(at.shape[1]), self.matrix[at[:, :, None], at[:, None, :]])
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", matrix), 1e-12))
        regular = matrix / (scale[:, :, None] * scale[:, None, :]) + 1e-6 * np.eye(at.shape[1])
        vector = np.where(empty, 0.0, self.vector[at])
        coefficients = np.linalg.solve(regular, (vector / scale)[..., None])[..., 0] / scale
        worth = 0.5 * np.einsum("ni,ni->n", vector, coefficients) - self.price[sets].sum(axis=1)
        coefficients = coefficients.reshape(n, size, self.members.shape[1])
        least = 1e-3  # share of a column that others must leave of it, for its coefficient to mean anything
        nothing = (~empty & (scale < least * np.sqrt(np.maximum(self.own[at], 1e-12)))).any(axis=1)
        barred = ((coefficients < self.least[sets]) | (coefficients > self.most[sets])).any(axis=(1, 2))
        place = np.sort(self.place[sets], axis=1)
        twice = (place[:, 1:] == place[:, :-1]).any(axis=1)
        return np.where(nothing | barred | twice, -np.inf, worth), coefficients


def _present(hypothesis: Hypothesis, sizes: Array) -> Effect:
    """The effect with these coefficients."""
    values = {p.name: float(p.absent + size) for p, size in zip(hypothesis.coefficients, sizes, strict=False)}
    return hypothesis.effect.with_parameters(**values)
