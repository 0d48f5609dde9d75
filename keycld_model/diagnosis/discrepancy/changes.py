"""Which effect differs between two sets of recordings, by more than recordings of one set differ among themselves."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis.discrepancy.regression import Mask, Regression
from keycld_model.diagnosis.search.hypotheses import Hypothesis

Array = NDArray[np.float64]
Key = tuple[str, str]


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with its columns among those of a regression.

    Attributes:
        hypothesis: an effect at a place, with its nonlinear parameters at one value.
        columns: indices of one column per coefficient, or of one for the effect as it is.
        changed: the same for the difference, where the effect is no line and the difference large; else none.
        precision: of what both sets have of it.
    """

    hypothesis: Hypothesis
    columns: tuple[int, ...]
    changed: tuple[int, ...] = ()
    precision: float = 0.0

    @property
    def of_difference(self) -> tuple[int, ...]:
        """Columns of the difference."""
        return self.changed or self.columns

    @property
    def key(self) -> Key:
        """Effect and place."""
        return self.hypothesis.key


@dataclass(frozen=True)
class Difference:
    """A candidate in both sets, and its difference in the new one.

    Attributes:
        candidate: what was tested.
        gain: nats of the difference.
        values: `[k]` of its coefficients, new minus baseline.
        covariance: `[k, k]` of these, were the discrepancy as white as it is taken to be.
        common: `[k]` coefficients in the baseline.
    """

    candidate: Candidate
    gain: float
    values: Array
    covariance: Array
    common: Array

    @property
    def effect(self) -> Effect:
        """The effect as large as the difference, which may be less than none."""
        hypothesis = self.candidate.hypothesis
        return replace(hypothesis.effect, **hypothesis.numbers(self.values))


@dataclass(frozen=True)
class Column:
    """A column of a design: one of the regression's, in some of the recordings only.

    Attributes:
        index: among the shared columns and then the others.
        recordings: where it is not zero.
        precision: of its prior.
    """

    index: int
    recordings: frozenset[int]
    precision: float


@dataclass
class Contest:
    """All candidates, and what runs of the baseline differ in among themselves.

    Attributes:
        regression: columns.
        candidates: what may have changed.
        recording: `[W]` recording of each window.
        baseline: recordings of the baseline.
        new: the others.
        zeros: indices of shared columns that may differ between the sets, with their spreads.
        by_run: columns that differ from run to run in the baseline, with their precisions.
    """

    regression: Regression
    candidates: Sequence[Candidate]
    recording: NDArray[np.int64]
    baseline: tuple[int, ...]
    new: tuple[int, ...]
    zeros: Sequence[tuple[int, float]]
    by_run: list[tuple[int, float]] = field(default_factory=list)
    _grams: dict[int, Array] = field(default_factory=dict, repr=False)

    def with_regression(self, regression: Regression) -> "Contest":
        """The same of other columns, of which the first are the same."""
        return replace(self, regression=regression, _grams={})

    def windows(self, recordings: Iterable[int]) -> Mask:
        """Those of some recordings."""
        return np.isin(self.recording, list(recordings))

    def design(self, baseline: Iterable[int], new: Iterable[int]) -> list[Column]:
        """Columns that may differ between two sets beside those that are shared."""
        both = (*baseline, *new)
        out = [Column(i, frozenset(new), spread**-2) for i, spread in self.zeros]
        out += [Column(i, frozenset([r]), precision) for i, precision in self.by_run for r in both]
        return out

    def _explicit(self, windows: Mask, columns: Sequence[Column]) -> tuple[Array, Array]:
        """Columns `[w, r, k]` and their precisions."""
        p, recording = self.regression.shared.shape[2], self.recording[windows]
        out = np.empty((*self.regression.target[windows].shape, len(columns)))
        for k, column in enumerate(columns):
            own = self.regression.shared if column.index < p else self.regression.others
            values = own[..., column.index if column.index < p else column.index - p]
            out[..., k] = values[windows] * np.isin(recording, list(column.recordings))[:, None]
        return out, np.array([c.precision for c in columns])

    def test(
        self, candidate: Candidate, baseline: Sequence[int], new: Sequence[int], present: Sequence[Column] = ()
    ) -> Difference:
        """A candidate fitted in both sets, with and without a difference; robustly.

        Args:
            candidate: what is tested.
            baseline: recordings.
            new: recordings.
            present: differences that are there already.
        """
        windows, p = self.windows([*baseline, *new]), self.regression.shared.shape[2]
        common, everywhere = [*self.design(baseline, new), *present], frozenset([*baseline, *new])
        own = [Column(p + i, everywhere, candidate.precision) for i in candidate.columns]
        other = [Column(p + i, frozenset(new), 0.0) for i in candidate.of_difference]
        columns, precision = self._explicit(windows, [*common, *own, *other])
        k = len(own)
        without = self.regression.solve(windows, columns[..., :-k], precision[:-k])
        fits = [self.regression.solve(windows, columns, precision, start) for start in (without.weights, None)]
        best = min(fits, key=lambda s: s.nats)
        undetermined = bool(np.any(best.determined[-k:] < 1e-4))
        return Difference(
            candidate,
            0.0 if undetermined else without.nats - best.nats,
            best.values[-k:],
            best.covariance[-k:, -k:],
            best.values[-2 * k : -k],
        )

    def gained(self, candidate: Candidate, values: Array, recording: int, present: Sequence[Column] = ()) -> float:
        """Nats that a difference of a given size gains in one new recording, all else fitted to the baseline and it."""
        windows, p = self.windows([*self.baseline, recording]), self.regression.shared.shape[2]
        both = frozenset([*self.baseline, recording])
        own = [Column(p + i, both, candidate.precision) for i in candidate.columns]
        columns, precision = self._explicit(windows, [*self.design(self.baseline, [recording]), *present, *own])
        other, _ = self._explicit(
            windows, [Column(p + i, frozenset([recording]), 0.0) for i in candidate.of_difference]
        )
        changed = replace(self.regression, target=self.regression.target.copy())
        changed.target[windows] -= other @ values
        nats = [r.solve(windows, columns, precision).nats for r in (self.regression, changed)]
        return nats[0] - nats[1]

    def weigh(self, baseline: Sequence[int], new: Sequence[int], present: Sequence[Column] = ()) -> None:
        """Grams of all columns in each recording, windows weighted as where nothing differs."""
        windows = self.windows([*baseline, *new])
        columns, precision = self._explicit(windows, [*self.design(baseline, new), *present])
        weights = np.ones(len(self.recording))
        weights[windows] = self.regression.solve(windows, columns, precision).weights
        r = self.regression
        for number in (*baseline, *new):
            own = self.recording == number
            everything = np.concatenate([r.shared[own], r.others[own], r.target[own][..., None]], axis=-1)
            flat = (everything * np.sqrt(weights[own])[:, None, None]).reshape(-1, everything.shape[-1])
            self._grams[number] = flat.T @ flat

    def screen(self, baseline: Sequence[int], new: Sequence[int], present: Sequence[Column] = ()) -> Array:
        """Nats of every candidate's difference, by the weights of `weigh`, `[n]`."""
        both, p = (*baseline, *new), self.regression.shared.shape[2]
        total = np.sum([self._grams[r] for r in both], axis=0)
        fresh = np.sum([self._grams[r] for r in new], axis=0)
        extra = [*self.design(baseline, new), *present]
        number, c, n = p + len(extra), self.regression.others.shape[2], total.shape[0]
        matrix, tested = np.zeros((number, number)), np.zeros((number, 2 * c + 1))
        matrix[:p, :p] = total[:p, :p] + np.diag(self.regression.precision)
        tested[:p] = np.concatenate([total[:p, p:-1], fresh[:p, p:-1], total[:p, -1:]], axis=1)
        within = [np.sum([self._grams[r] for r in both if r in e.recordings] or [np.zeros((n, n))], 0) for e in extra]
        for k, column in enumerate(extra):
            row, common = within[k][column.index], [r for r in new if r in column.recordings]
            matrix[p + k, :p] = matrix[:p, p + k] = row[:p]
            for m, other in enumerate(extra):
                shared = [self._grams[r][column.index, other.index] for r in column.recordings & other.recordings]
                matrix[p + k, p + m] = sum(shared)
            matrix[p + k, p + k] += column.precision
            now = np.sum([self._grams[r][column.index] for r in common] or [np.zeros(n)], axis=0)
            tested[p + k] = np.concatenate([row[p:-1], now[p:-1], row[-1:]])
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        factor = np.linalg.cholesky(matrix / scale[:, None] / scale + 1e-9 * np.eye(number))
        seen = np.linalg.solve(factor, tested / scale[:, None])
        both_, new_, target = seen[:, :c], seen[:, c:-1], seen[:, -1]
        out = np.zeros(len(self.candidates))
        for i, candidate in enumerate(self.candidates):
            m = np.array(candidate.columns)
            a, b, k = both_[:, m], new_[:, m], len(m)
            at = p + m
            known, late = np.ix_(at, at), fresh[np.ix_(at, at)]
            total_own = total[known] + candidate.precision * np.eye(k)
            normal = np.block([[total_own - a.T @ a, late - a.T @ b], [late - b.T @ a, late - b.T @ b]])
            right = np.concatenate([total[at, -1] - a.T @ target, fresh[at, -1] - b.T @ target])
            size = np.sqrt(np.maximum(np.concatenate([np.diag(total_own), np.diag(late)]), 1e-300))
            normal, right = normal / size[:, None] / size, right / size
            common = np.linalg.pinv(normal[:k, :k], rcond=1e-8, hermitian=True)
            left = normal[k:, k:] - normal[k:, :k] @ common @ normal[:k, k:]
            rest = right[k:] - normal[k:, :k] @ common @ right[:k]
            values, vectors = np.linalg.eigh(left)
            good = values > 1e-4
            if good.all():
                out[i] = 0.5 * float(np.sum((vectors.T @ rest) ** 2 / values))
        return out
