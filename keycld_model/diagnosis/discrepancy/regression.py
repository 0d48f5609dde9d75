"""Regression of what a motion needs on what may explain it, when much of it is explained by nothing.

What is left is taken for unknown forces, independent from part to part of a window, vibrations that last a while, and
noise of the sensors; their sizes are those under which the baseline is most likely (restricted maximum likelihood;
Patterson and Thompson, 1971). Where a joint rests, dry friction may be any force up to its own, so that forces there
count for less. Windows have Student's t distribution (Lange, Little and Taylor, 1989), since some fit far worse than
others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from keycld_model.diagnosis.discrepancy.covariance import Discrepancy, Unsteady
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regressors import Term

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FREEDOM = 4.0
"""Degrees of freedom of Student's t, over windows."""


@dataclass(frozen=True)
class Solution:
    """Coefficients of some columns.

    Attributes:
        nats: minus log-likelihood, and what priors cost.
        values: `[P]`.
        covariance: `[P, P]`.
        weights: `[w]` of the windows.
        determined: `[P]` share of each column that the others leave of it.
    """

    nats: float
    values: Array
    covariance: Array
    weights: Array
    determined: Array

    @property
    def deviations(self) -> Array:
        """`[P]` standard deviations of the values."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True)
class Regression:
    """Columns in which initial states are explained and the discrepancy is white.

    Attributes:
        target: `[W, r]` what is to be explained.
        shared: `[W, r, P]` columns of terms.
        precision: `[P]` of their priors.
        others: `[W, r, C]` columns of all that is tested.
        freedom: of each window.
        factor: `[W, r, r]` triangular, of the covariance of the discrepancy.
        basis: `[W, r, 2 nv]` orthonormal: what initial states explain.
    """

    target: Array
    shared: Array
    precision: Array
    others: Array
    freedom: int
    factor: Array = field(repr=False)
    basis: Array = field(repr=False)

    def white(self, columns: Array) -> Array:
        """Columns `[W, r, k]` of the motion as they stand here."""
        out = np.linalg.solve(self.factor, columns)
        return out - self.basis @ (np.swapaxes(self.basis, 1, 2) @ out)

    def with_others(self, columns: Array) -> "Regression":
        """With columns `[W, r, k]` of the motion after the others."""
        return replace(self, others=np.concatenate([self.others, self.white(columns)], axis=-1))

    def solve(self, windows: Mask, columns: Array, precision: Array, start: Array | None = None) -> Solution:
        """Fit shared terms and further columns `[w, r, k]` to some windows (iteratively reweighted least squares)."""
        everything = np.concatenate([self.shared[windows], columns, self.target[windows][..., None]], axis=-1)
        gram = np.swapaxes(everything, 1, 2) @ everything
        return _solve(gram, np.concatenate([self.precision, precision]), self.freedom, start)


def _solve(gram: Array, precision: Array, freedom: int, start: Array | None) -> Solution:
    """From grams `[w, P + 1, P + 1]` of columns and target."""
    normal, right, square = gram[:, :-1, :-1], gram[:, :-1, -1], gram[:, -1, -1]
    weights = np.ones(len(gram)) if start is None else start
    before = np.inf
    for iteration in range(12):
        matrix = np.tensordot(weights, normal, 1) + np.diag(precision)
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        inverse = np.linalg.pinv(matrix / scale[:, None] / scale, rcond=1e-10, hermitian=True)
        values = inverse @ ((weights @ right) / scale) / scale
        squares = np.maximum(square - 2 * right @ values + (normal @ values) @ values, 1e-12)
        nats = 0.5 * (FREEDOM + freedom) * np.log1p(squares / FREEDOM).sum() + 0.5 * (precision * values**2).sum()
        if before - nats < 0.02 and iteration > 1:
            break
        weights, before = (FREEDOM + freedom) / (FREEDOM + squares), nats
    determined = 1 / np.maximum(np.diag(inverse), 1e-300)
    return Solution(float(nats), values, inverse / scale[:, None] / scale, weights, determined)


def robust_weights(white: Array, precision: Array, freedom: int) -> Array:
    """Weights `[W]` of windows whose white columns and target are `[W, r, P + 1]`."""
    return _solve(np.swapaxes(white, 1, 2) @ white, precision, freedom, None).weights


def robust_squares(columns: Array, freedom: float) -> Array:
    """Mean squares `[W]` that all columns but the last leave of it, `[W, r, P + 1]`, bad windows counting for less."""
    weights = np.ones(len(columns))
    for _ in range(10):
        flat = (columns * np.sqrt(weights)[:, None, None]).reshape(-1, columns.shape[-1])
        scale = np.maximum(np.linalg.norm(flat[:, :-1], axis=0), 1e-300)
        values = np.linalg.lstsq(flat[:, :-1] / scale, flat[:, -1], rcond=1e-9)[0] / scale
        squares = np.sum((columns[..., -1] - columns[..., :-1] @ values) ** 2, axis=1) / freedom
        weights = 1 / (1 + squares / max(float(np.median(squares)), 1e-300))
    return squares


def regression(motion: Motion, terms: Sequence[Term], others: Array, baseline: Mask) -> tuple[Regression, Discrepancy]:
    """Columns in which the discrepancy of the baseline is white, and the discrepancy.

    Args:
        motion: of W windows.
        terms: shared by all windows.
        others: `[W, r, C]` what will be tested.
        baseline: `[W]` windows that the discrepancy is learned from.
    """
    problem = _Restricted.of(motion, terms, baseline)
    usual = np.sqrt(np.mean(motion.required**2, axis=(0, 1)))
    one, none = np.ones(len(usual)), np.zeros((len(baseline), len(usual)))
    found = Discrepancy(0.1 * usual, one, one, 0.1, 0.3 * usual, none, np.ones(len(baseline)))
    dry = [(i, term.holds) for i, term in enumerate(terms) if term.holds is not None]
    for _ in range(3):
        found = problem.most_likely(found)
        solved = problem.solved(found)
        size = np.abs(sum((solved.values[i] * holds for i, holds in dry), none))
        least = np.maximum(size.min(axis=0), 0.02 * usual)
        found = replace(found, friction=least, more=np.maximum(size - least, 0.0))
        problem = replace(problem, weights=solved.weights)
    share = problem.shares(found)
    usual = np.exp(np.mean(np.log(share[baseline])))  # terms of one run explain more of it than those of all
    share = np.minimum(share, share[baseline].max())  # what changed is no roughness
    found = replace(found, share=share / usual)
    return problem.regression(found, others), found


def whitened_again(
    motion: Motion, terms: Sequence[Term], others: Array, baseline: Mask, discrepancy: Discrepancy
) -> Regression:
    """The same columns with another discrepancy."""
    return _Restricted.of(motion, terms, baseline).regression(discrepancy, others)


@dataclass(frozen=True)
class _Restricted:
    """Restricted likelihood of discrepancies.

    Attributes:
        motion: of W windows.
        unsteady: where forces are known worse.
        shared: `[W, r, P]` columns of terms.
        precision: `[P]` of their priors.
        baseline: `[W]` windows that count.
        weights: of the windows that count; None for ones.
    """

    motion: Motion
    unsteady: Unsteady
    shared: Array
    precision: Array
    baseline: Mask
    weights: Array | None = None

    @classmethod
    def of(cls, motion: Motion, terms: Sequence[Term], baseline: Mask) -> "_Restricted":
        """With all windows of the baseline counting alike."""
        shared, spreads = np.stack([t.column for t in terms], axis=-1), np.array([t.spread for t in terms])
        return cls(motion, Unsteady.of(motion), shared, spreads**-2.0, baseline)

    def regression(self, discrepancy: Discrepancy, others: Array) -> Regression:
        """Shared and other columns `[W, r, C]` and the target, white and without what initial states explain."""
        rows, p = np.arange(len(self.motion.windows)), self.shared.shape[2]
        factor: Array = np.asarray(
            np.linalg.cholesky(discrepancy.covariance(self.motion, self.unsteady, rows)), np.float64
        )
        basis = np.linalg.qr(np.linalg.solve(factor, self.motion.states))[0]
        freedom = factor.shape[1] - basis.shape[2]
        nothing = np.zeros((*self.motion.residual.shape, 0))
        bare = Regression(nothing, nothing, self.precision, nothing, freedom, factor, basis)
        columns = [self.shared, others, self.motion.residual[..., None]]
        white = bare.white(np.concatenate(columns, axis=-1))
        return replace(bare, target=white[..., -1], shared=white[..., :p], others=white[..., p:-1])

    def _white(
        self, discrepancy: Discrepancy, rows: NDArray[np.int64], others: Array, weights: Array
    ) -> tuple[Array, float]:
        """The same, and the logarithms of determinants."""
        covariance = discrepancy.covariance(self.motion, self.unsteady, rows) / weights[:, None, None]
        factor, n = np.linalg.cholesky(covariance), self.motion.states.shape[2]
        columns = [self.motion.states, self.shared, others, self.motion.residual[..., None]]
        white = np.linalg.solve(factor, np.concatenate([c[rows] for c in columns], axis=-1))
        basis, upper = np.linalg.qr(white[..., :n])
        white = white[..., n:]
        diagonals = np.einsum("wii->wi", factor), np.abs(np.einsum("wii->wi", upper))
        return white - basis @ (np.swapaxes(basis, 1, 2) @ white), float(2 * sum(np.log(d).sum() for d in diagonals))

    def nats(self, discrepancy: Discrepancy) -> float:
        """Minus the logarithm of the restricted likelihood."""
        rows = np.flatnonzero(self.baseline)
        weights = np.ones(len(rows)) if self.weights is None else self.weights
        white, determinants = self._white(discrepancy, rows, self.shared[..., :0], weights)
        flat = white.reshape(-1, white.shape[-1])
        gram = flat.T @ flat
        matrix, right = gram[:-1, :-1] + np.diag(self.precision), gram[:-1, -1]
        scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled = matrix / scale[:, None] / scale + 1e-10 * np.eye(len(scale))
        left = gram[-1, -1] - right @ (np.linalg.solve(scaled, right / scale) / scale)
        return float(0.5 * (left + determinants + np.linalg.slogdet(scaled)[1]) + np.log(scale).sum())

    def most_likely(self, start: Discrepancy) -> Discrepancy:
        """Forces and noise under which the baseline is most likely, with this friction."""
        nv = len(start.force)
        least = self.motion.noise / self.motion.problem.noise

        def discrepancy(x: Array) -> Discrepancy:
            force, noise, vibration = np.exp(x[:-1]).reshape(3, nv)
            noise, lasts = np.maximum(noise, least), float(np.exp(x[-1]))
            return replace(start, force=force, noise=noise, vibration=vibration, correlation_time=lasts)

        middle = np.log(np.concatenate([start.force, start.noise, start.vibration, [start.correlation_time]]))
        bounds = [(x - 5, x + 5) for x in middle[:nv]] + [(-1.0, 3.0)] * nv + [(-4.0, 6.0)] * nv + [(-5.0, 0.0)]
        found = minimize(
            lambda x: self.nats(discrepancy(x)),
            np.clip(middle, *np.transpose(bounds)),
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": 12, "eps": 1e-3},
        )
        return discrepancy(found.x)

    def shares(self, found: Discrepancy) -> Array:
        """Of unknown forces in each window, as likely as can be in its recording, whose terms are its own, `[W]`."""
        recording, out = self.motion.windows.recording, np.ones(len(self.motion.windows))
        spread = self.motion.problem.criteria.spreads.roughness
        for run in np.unique(recording):
            own = recording == run
            alone, nats = replace(self, baseline=own, weights=None), dict[float, float]()

            def cost(x: float, own: Mask = own, alone: _Restricted = alone, nats: dict[float, float] = nats) -> float:
                share = np.where(own, np.exp(x), 1.0)
                nats[float(x)] = alone.nats(replace(found, share=share)) + 0.5 * float(x / spread) ** 2
                return nats[float(x)]

            minimize_scalar(cost, bounds=(-3 * spread, 3 * spread), method="bounded", options={"maxiter": 12})
            out[own] = np.exp(min(nats, key=nats.__getitem__))
        return out

    def solved(self, discrepancy: Discrepancy) -> Solution:
        """Terms of the baseline."""
        rows = np.flatnonzero(self.baseline)
        white, _ = self._white(discrepancy, rows, self.shared[..., :0], np.ones(len(rows)))
        return _solve(
            np.swapaxes(white, 1, 2) @ white,
            self.precision,
            white.shape[1] - self.motion.states.shape[2],
            self.weights,
        )
