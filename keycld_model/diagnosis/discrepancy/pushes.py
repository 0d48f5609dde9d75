"""Pushes in new recordings only: forces that come and go, where a baseline has none.

Along whole recordings, smoothed, some force is left by friction, masses and motors: those of both sets, and what the
new ones may have of them by themselves, in a regression in which samples far off hardly count. It is larger where
motion is fast and commands jump, as the baseline tells. A push is a bell in time that stands out more than any does in
runs of the baseline, each held against the others, and that other new recordings do not show in the same states, as
they would a lasting change.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls
from scipy.spatial import KDTree
from scipy.stats import t as student

from keycld_envs.effects import ActuatorGain, Effect
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.bells import DURATIONS, Standing, standing
from keycld_model.diagnosis.discrepancy.covariance import Discrepancy
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regressors import can_be_tested, force_of, resting, shared_terms
from keycld_model.diagnosis.discrepancy.smoothed import STEP, Smoothed, within_range

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
CORRELATED = 0.1
"""Time after which an unexplained force is another one, s; so many samples count as one."""
AROUND = 0.2
"""Standard deviation of the time over which circumstances count together, s: as long as pushes are. Held-out runs of
baselines are more likely so than with .05 or .1 s (docs/notebook/2026-11-25-pushes.md)."""
MASSES = 0.1
"""Share of their spread by which masses may differ from those that windows told, since accelerations are smoothed."""
SHARE = 0.1
"""Of the forces of a motion that new recordings may have more or less of any friction."""
SLOW = 0.3
"""Speed below which friction is not what it is beyond, rad/s or m/s."""


@dataclass(frozen=True)
class Push:
    """A force that came and went.

    Attributes:
        recording: its number.
        dof: at which it pushed.
        start: s from the start of the recording; until then it is a seventh of its greatest.
        duration: s.
        force: greatest, N m or N.
        deviation: standard deviation of this force, N m or N.
        times: how much it stands out, over the most that chance makes stand out.
    """

    recording: int
    dof: int
    start: float
    duration: float
    force: float
    deviation: float
    times: float

    @property
    def end(self) -> float:
        """Seconds from the start of the recording."""
        return self.start + self.duration


@dataclass(frozen=True)
class Pushes:
    """Looks for pushes.

    Attributes:
        motion: whole recordings.
        columns: `[W, S, nv, P]` of terms, N m or N per unit.
        precision: `[P]` of what differs from the values that windows told.
        own: `[W, S, nv, K]` what new recordings may have by themselves.
        own_precision: `[K]` of it.
        target: `[W, S, nv]` forces that those values leave, N m or N.
        scale: `[nv]` usual size of what nothing explains, N m or N.
        held: `[W, S, nv]` standard deviation of dry friction where joints rest, which holds any force up to its own,
            N m or N.
        circumstances: `[W, S, F]` squares with which it grows.
        baseline: recordings.
        new: the others.
        criteria: thresholds.
    """

    motion: Smoothed
    columns: Array
    precision: Array
    own: Array
    own_precision: Array
    target: Array
    scale: Array
    held: Array
    circumstances: Array
    baseline: tuple[int, ...]
    new: tuple[int, ...]
    criteria: Criteria

    @classmethod
    def of(
        cls, motion: Motion, values: dict[str, float], discrepancy: Discrepancy, baseline: int, criteria: Criteria
    ) -> "Pushes":
        """Of the recordings of a motion.

        Args:
            motion: followed in windows.
            values: of shared terms, in both sets, by name.
            discrepancy: that the baseline leaves.
            baseline: number of recordings of the baseline, the first ones.
            criteria: thresholds.
        """
        whole = Smoothed.whole(motion)
        none = np.zeros((len(whole.v), whole.v.shape[2]))
        terms = shared_terms(whole, criteria)
        columns = np.stack([t.column for t in terms], axis=-1).reshape(*whole.v.shape, -1)
        common = np.array([values.get(t.name, 0.0) for t in terms])
        target = whole.residual.reshape(whole.v.shape) - columns @ common
        friction = np.abs(sum((v * t.holds for v, t in zip(common, terms, strict=True) if t.holds is not None), none))
        inertial = np.array([t.effect is None and not (t.zero or t.beyond) for t in terms])
        spreads = np.array([t.spread for t in terms])
        gains = [e.with_parameters(k=2.0) for e in ActuatorGain.candidates(whole.model)]
        own = np.concatenate([columns[..., ~inertial], _columns(whole, gains)], axis=-1)
        usual = np.sqrt(np.mean(whole.required[whole.inside] ** 2, axis=0))
        size = np.sqrt(np.mean(own[whole.inside] ** 2, axis=0))
        expected = np.max(SHARE * usual[:, None] / np.maximum(size, 1e-12), axis=0, where=size > 0, initial=0.0)
        known = np.concatenate([spreads[~inertial], np.full(own.shape[-1] - int((~inertial).sum()), np.inf)])
        numbers = np.arange(len(whole.v))
        return cls(
            whole,
            columns,
            (spreads * np.where(inertial, MASSES, 1.0)) ** -2.0,
            own,
            np.where(np.isfinite(known), known, np.maximum(expected, 1e-12)) ** -2.0,
            target,
            discrepancy.force,
            friction[:, None] * resting(whole.v) / np.sqrt(3),
            _circumstances(whole),
            tuple(numbers[:baseline].tolist()),
            tuple(numbers[baseline:].tolist()),
            criteria,
        )

    def found(self, changes: Sequence[Effect]) -> list[Push]:
        """Pushes in new recordings beside lasting changes, those that stand out most first.

        None are found where they would be anywhere: then it is something else.
        """
        forces = [e for e in changes if not e.observes]
        new = self._standing(self.baseline, self.new, _columns(self.motion, forces))
        least = self._least()
        peaks = [p for number, stands in new.items() for p in self._peaks(number, stands, least)]
        peaks = [p for p in peaks if not self._elsewhere(p, new)]
        seconds = STEP * self.motion.inside[list(self.new)].sum()
        if sum(p.duration for p in peaks) > self.criteria.pushed * seconds:
            return []
        return sorted(peaks, key=lambda p: -p.times)

    def _least(self) -> Array:
        """How much a bell of each duration stands out by chance in one of many comparisons, `[D]`.

        Logarithms of the most in each run of the baseline, held against the others, at each joint, in units of what is
        usual for the duration, are about normal; a further one is below a prediction limit (Student's t; Hahn and
        Meeker, 1991).
        """
        runs = []
        for run in self.baseline:
            others = tuple(r for r in self.baseline if r != run)
            runs.append(self._standing(others, (run,), self.own[..., :0])[run].most)
        most = np.log(np.maximum(np.concatenate(runs, axis=1), 1e-12))
        usual = most.mean(axis=1, keepdims=True)
        x = (most - usual).max(axis=0)
        chance = self.criteria.false_push / (len(self.scale) * len(self.new))
        beyond = student.ppf(1 - chance, len(x) - 1) * np.sqrt(1 + 1 / len(x)) * x.std(ddof=1)
        return np.exp(usual[:, 0] + x.mean() + beyond)

    def _standing(self, baseline: Sequence[int], new: Sequence[int], changed: Array) -> dict[int, Standing]:
        """How bells stand out in new recordings, which have columns `[W, S, nv, C]` of changes by themselves."""
        both = [*baseline, *new]
        left, known = self._left(both, new, changed), self._known(both, baseline)
        calm = [known[r] for r in baseline]
        squares = np.concatenate([left[r][k] ** 2 for r, k in zip(baseline, calm, strict=True)])
        squares = np.minimum(squares, 50 * np.median(squares, axis=0))  # single samples do not count
        grows = np.concatenate([self.circumstances[r][k] for r, k in zip(baseline, calm, strict=True)])
        shares = np.stack([nnls(grows, column)[0] for column in squares.T], axis=-1)
        out = {}
        for r in new:
            spread = np.sqrt(self.circumstances[r] @ shares + self.held[r] ** 2 + (0.2 * self.scale) ** 2)
            out[r] = standing(left[r], spread, known[r])
        return out

    def _known(self, recordings: Sequence[int], baseline: Sequence[int]) -> dict[int, Mask]:
        """Where each is within the range of a baseline, `[S]`."""
        return dict(zip(recordings, within_range(self.motion, recordings, baseline), strict=True))

    def _left(self, recordings: Sequence[int], new: Sequence[int], changed: Array) -> dict[int, Array]:
        """Forces that nothing explains, `[S, nv]` (iteratively reweighted least squares; Geman and McClure, 1985)."""
        at, nv = list(recordings), len(self.scale)
        inside, is_new = self.motion.inside[at], np.isin(at, list(new))
        extra = np.concatenate([self.own, changed], axis=-1)[at] * is_new[:, None, None, None]
        x = np.concatenate([self.columns[at], extra], axis=-1)
        y, rows = self.target[at], x[inside]
        precision = np.concatenate([self.precision, self.own_precision, np.zeros(changed.shape[-1])])
        weights, scale = np.ones((len(rows), nv)), np.maximum(self.scale, y[inside].std(axis=0))
        for _ in range(12):
            flat = (rows * (np.sqrt(weights) / scale)[..., None]).reshape(-1, rows.shape[-1])
            right = (y[inside] * np.sqrt(weights) / scale).ravel()
            normal = STEP / CORRELATED * flat.T @ flat + np.diag(precision)
            size = np.sqrt(np.diag(normal) + 1e-300)
            values = np.linalg.lstsq(normal / size[:, None] / size, STEP / CORRELATED * flat.T @ right / size)[0] / size
            left = y - x @ values
            scale = np.maximum(self.scale, 1.48 * np.median(np.abs(left[inside]), axis=0))  # at first, pushes bend all
            weights = (1 + (left[inside] / (2 * scale)) ** 2) ** -2
        return dict(zip(at, left, strict=True))

    def _peaks(self, number: int, stands: Standing, least: Array) -> list[Push]:
        """Bells that stand out, one after the other, without those that overlap them at any joint."""
        times, out = np.abs(stands.score) / least[:, None, None], []
        while times.max() > 1.0:
            d, k, dof = (int(i) for i in np.unravel_index(np.argmax(times), times.shape))
            most, near = float(times[d, k, dof]), round(DURATIONS[d] / 2 / STEP)
            first = max(0, k - near)
            gain = np.where(stands.score[:, first : k + near, dof], stands.gain[:, first : k + near, dof], 0.0)
            d, k = (int(i) for i in np.unravel_index(np.argmax(gain), gain.shape))  # its best time and duration
            k += first
            duration, height = DURATIONS[d], float(stands.height[d, k, dof])
            start = float(self.motion.time[number, k]) - duration / 2
            deviation = abs(height / float(stands.score[d, k, dof]))
            out.append(Push(number, dof, start, duration, height, deviation, most))
            for e, other in enumerate(DURATIONS):
                around = round((duration + other) / 2 / STEP)
                times[e, max(0, k - around) : k + around + 1] = 0.0
        return out

    def _elsewhere(self, push: Push, new: dict[int, Standing]) -> bool:
        """Whether there is such a force in the states that are most alike in other new recordings, or later or earlier.

        Then it belongs to the states, and nobody pushes.
        """
        time, centre = self.motion.time[0], push.start + push.duration / 2
        within, away = np.abs(time - centre) < push.duration / 2, np.abs(time - centre) > push.duration
        here, states = float(new[push.recording].left[within, push.dof].mean()), self._states()

        def share(recording: int) -> float:
            there = self.motion.inside[recording] & (away if recording == push.recording else True)
            if not there.any():
                return 0.0
            nearest = KDTree(states[recording][there]).query(states[push.recording][within])[1]
            return float(new[recording].left[there][nearest, push.dof].mean()) / here

        others = [share(r) for r in self.new if r != push.recording]
        there = max(share(push.recording), float(np.median(others or [0.0])))
        return there > self.criteria.push_elsewhere

    def _states(self) -> Array:
        """Positions and velocities in units of what the baseline has, `[W, S, n]`; hinges turn round."""
        m, old = self.motion, list(self.baseline)
        states = np.concatenate([np.sin(m.q), np.cos(m.q), m.v], axis=-1)
        return states / (states[old][m.inside[old]].std(axis=0) + 1e-9)


def _columns(motion: Smoothed, effects: Iterable[Effect]) -> Array:
    """Forces of effects that can be tested, `[W, S, nv, C]`, smoothed as the motion is."""
    found = [motion.answer(force_of(motion, e)) for e in effects if can_be_tested(e, motion.model)]
    return np.stack([*found], axis=-1).reshape(*motion.v.shape, -1) if found else np.zeros((*motion.v.shape, 0))


def _circumstances(motion: Smoothed) -> Array:
    """Squares with which unexplained forces may grow, `[W, S, F]`, in units of their means; the first is one."""
    rate = np.gradient(motion.u, STEP, axis=1)
    rest = 1 - np.tanh(np.abs(motion.v) / SLOW) ** 2
    squares = np.concatenate([motion.required**2, motion.v**2, rate**2, rest], axis=-1)
    squares = gaussian_filter1d(squares, AROUND / STEP, axis=1, mode="nearest")
    squares /= squares[motion.inside].mean(axis=0) + 1e-12
    return np.concatenate([np.ones_like(squares[..., :1]), squares], axis=-1)
