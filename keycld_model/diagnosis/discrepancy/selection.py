"""Changes that are accepted one after the other, and what else would explain each as well."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import ActuatorDeadZone, ActuatorGain, AsymmetricFriction, Effect, PositionDependentFriction
from keycld_envs.effects.places import ActuatorEffect
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.candidates import Columns, bent, refined
from keycld_model.diagnosis.discrepancy.changes import Candidate, Column, Contest, Difference, Key
from keycld_model.diagnosis.discrepancy.covariance import Discrepancy
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regression import Mask, whitened_again
from keycld_model.diagnosis.discrepancy.regressors import Term, share_of_torque

Array = NDArray[np.float64]
FINALISTS = 14
"""Candidates that are fitted robustly, of those that gain most to first order."""


@dataclass(frozen=True)
class Ranked:
    """A difference among others.

    Attributes:
        difference: what was tested.
        chance: nats that such a difference gains between runs of the baseline, at least one per number.
    """

    difference: Difference
    chance: float

    @property
    def times(self) -> float:
        """Its gain over that of chance."""
        return self.difference.gain / self.chance

    @property
    def effect(self) -> Effect:
        """Of the candidate."""
        return self.difference.candidate.hypothesis.effect

    @property
    def numbers(self) -> int:
        """How many parameters it has."""
        return len(self.effect.parameters())


@dataclass(frozen=True)
class Change:
    """An accepted difference.

    Attributes:
        effect: with its parameters; a coefficient is `absent` plus its difference.
        deviations: standard deviation of each parameter's difference, in their order.
        ranked: how much it gains.
        rivals: what explains as much, with the weight of each beside one of the change's own.
        held_out: nats gained on recordings whose own part in the size was left out.
        columns: of it in the new recordings.
    """

    effect: Effect
    deviations: Array
    ranked: Ranked
    rivals: tuple[tuple[Ranked, float], ...]
    held_out: float
    columns: tuple[Column, ...]

    def sized(self, contest: Contest, new: Sequence[int]) -> Effect:
        """The effect with sizes from some of the new recordings."""
        return contest.test(self.ranked.difference.candidate, contest.baseline, new).effect


@dataclass
class Selection:
    """Finds changes.

    Attributes:
        motion: of both sets.
        terms: that both share.
        columns: of all candidates.
        contest: in which they are tested.
        discrepancy: that nothing explains.
        baseline: `[W]` windows of the baseline.
        criteria: thresholds.
        chance: nats of each candidate between runs of the baseline, by effect and place.
        taken: what was accepted.
    """

    motion: Motion
    terms: Sequence[Term]
    columns: Columns
    contest: Contest
    discrepancy: Discrepancy
    baseline: Mask
    criteria: Criteria
    chance: dict[Key, float]
    taken: set[Key] = field(default_factory=set)

    def changes(
        self, advance: Callable[..., None], leaves_out: Callable[[str], bool]
    ) -> tuple[list[Change], Ranked | None, bool]:
        """Accepted changes, the best one that was not, and whether it gains in some of the new recordings only."""
        found: list[Change] = []
        while len(found) < self.criteria.sizes.effects:
            if found and leaves_out(f"changes after the first {len(found)}"):
                break
            present = [column for change in found for column in change.columns]
            ranked = self._ranked(present)
            clear = self._clear(ranked)
            if not clear:
                return found, ranked[0] if ranked else None, False
            advance(0, f"sizing {clear[0].effect.id} at {clear[0].effect.where}")
            change = self._change(clear, ranked, present)
            if change.held_out <= 0 or change.ranked.difference.gain < self._least(change, found):
                return found, change.ranked, not found
            found.append(change)
            self.taken.add(change.effect.key)
        return found, None, False

    def instead_of(self, first: Change) -> list[Change]:
        """What the rivals of the first change would be in its place; it is then one of theirs, and no likelier."""
        out = []
        for rival, _ in first.rivals:
            own = [c for c in self.contest.candidates if c.key == rival.effect.key]
            tested = [self.contest.test(c, self.contest.baseline, self.contest.new) for c in own]
            best = max((Ranked(d, self._chance(d)) for d in tested), key=self._score)
            change = self._change([best], [best], [])
            others = [(r, w) for r, w in first.rivals if r is not rival]
            out.append(replace(change, rivals=((first.ranked, 1.0), *others)))
        return [c for c in out if c.held_out > 0 and _possible(c.ranked.difference) and self._drives(c.ranked)]

    def _clear(self, ranked: Sequence[Ranked]) -> list[Ranked]:
        """Those that come near the best and gain more than chance does, the best first.

        Where one of a family does so at a place, something is different there, and which of the family is told by the
        score alone.
        """
        first = self._score(ranked[0]) if ranked else 0.0
        near = [r for r in ranked if self._score(r) > 0.5 * first > 0]
        if not any(r.times >= self.criteria.changed and self._score(r) > 0.8 * first for r in near):
            return []
        sure = {(r.effect.family, r.effect.where) for r in near if r.times >= self.criteria.changed}
        return [r for r in near if (r.effect.family, r.effect.where) in sure]

    def _least(self, change: Change, found: Sequence[Change]) -> float:
        """Nats of a further change: at other joints a share of what was found, at the same ones as much."""
        model, share = self.motion.model, self.criteria.further_change
        own = joint_of(change.effect, model)
        return max(
            (
                f.ranked.difference.gain * (share if own not in (None, joint_of(f.effect, model)) else 1.0)
                for f in found
            ),
            default=0.0,
        )

    def _ranked(self, present: Sequence[Column]) -> list[Ranked]:
        """Candidates that are possible, the best first."""
        best = self._tested(present)
        joint = _dry_joint(best, self.motion)
        if joint is not None and not present:
            size = next((r.difference.values[0] for r in best if r.effect.id == "coulomb_friction"), 0.0)
            more = self.discrepancy.more.copy()
            new = ~self.baseline  # where it rests, the new friction may be any force as well
            more[new, joint] = np.maximum(more[new, joint], abs(size))
            self.discrepancy = replace(self.discrepancy, more=more)
            again = whitened_again(self.motion, self.terms, self.columns.answers, self.baseline, self.discrepancy)
            self.contest = self.contest.with_regression(again)
            best = self._tested(present)
        possible = [r for r in best if _possible(r.difference) and self._drives(r)]
        return sorted(possible, key=self._score, reverse=True)

    def _drives(self, ranked: Ranked) -> bool:
        """Whether motors still do some of what they are told, in new recordings.

        Of a dead zone beyond all commands nothing tells how large it is, and a motor that does nothing is any friction
        that its commands made up for.
        """
        effect = ranked.difference.effect
        if not isinstance(effect, ActuatorDeadZone | ActuatorGain):
            return True
        return share_of_torque(self.motion, effect, ~self.baseline) < self.criteria.motorless

    def _score(self, ranked: Ranked) -> float:
        """Gain, of which chance is paid, and each number: forms are idealised, so that more of them always gain."""
        gain = ranked.difference.gain
        return gain - 3.0 * ranked.chance - self.criteria.idealised_share * gain * ranked.numbers

    def _likelihood(self, ranked: Ranked, best: Ranked) -> float:
        """Of a rival beside the best: forms are idealised, so that a small share of the gain tells nothing."""
        tells = max(best.chance, self.criteria.idealised_share * best.difference.gain)
        return float(np.exp((self._score(ranked) - self._score(best)) / tells))

    def _tested(self, present: Sequence[Column]) -> list[Ranked]:
        """The most promising candidates, fitted robustly, the best first."""
        contest = self.contest
        contest.weigh(contest.baseline, contest.new, present)
        gains = contest.screen(contest.baseline, contest.new, present)
        best: dict[Key, int] = {}
        for i in np.argsort(-gains):
            if contest.candidates[i].key not in self.taken:
                best.setdefault(contest.candidates[i].key, int(i))
        chosen = [contest.candidates[i] for i in list(best.values())[:FINALISTS]]
        tested = [contest.test(c, contest.baseline, contest.new, present) for c in chosen]
        out = [Ranked(d, self._chance(d)) for d in tested]
        return sorted(out, key=lambda r: r.difference.gain, reverse=True)

    def _chance(self, difference: Difference) -> float:
        return max(float(len(difference.values)), self.chance.get(difference.candidate.key, 0.0))

    def _change(self, clear: Sequence[Ranked], ranked: Sequence[Ranked], present: Sequence[Column]) -> Change:
        """The best with its parameters, refined beside those that come near."""
        near = clear[:5]
        fits = [self._refined(r, present) for r in near]
        fits = [fit for fit in fits if self._drives(fit[1])] or fits
        contest, best = max(fits, key=lambda fit: self._score(fit[1]))
        rest = [r for _, r in fits if r is not best] + [r for r in ranked if r not in near]
        weight = {id(r): self._likelihood(r, best) for r in rest}
        least = (1 - self.criteria.rival_share) * self._score(best)
        difference = best.difference
        p = contest.regression.shared.shape[2]
        columns = [Column(p + i, frozenset(contest.new), 0.0) for i in difference.candidate.of_difference]
        self.contest = contest
        return Change(
            difference.effect,
            self._deviations(contest, best, present),
            best,
            tuple((r, weight[id(r)]) for r in rest if self._score(r) > least),
            self._held_out(contest, difference.candidate, present),
            tuple(columns),
        )

    def _refined(self, ranked: Ranked, present: Sequence[Column]) -> tuple[Contest, Ranked]:
        def test(contest: Contest, candidate: Candidate) -> Difference:
            return contest.test(candidate, contest.baseline, contest.new, present)

        contest, difference = refined(self.contest, self.motion, ranked.difference, test)
        return contest, Ranked(difference, self._chance(difference))

    def _deviations(self, contest: Contest, ranked: Ranked, present: Sequence[Column]) -> Array:
        """Of all parameters, as much larger than white forces allow as runs of the baseline differ more than by chance.

        Half a nat per number is what white forces alone would gain. Nonlinear parameters are told by how the gain bends
        there; where it does not, they are off by as much as they are.
        """
        d = ranked.difference
        larger = max(1.0, 2 * ranked.chance / len(d.values))
        out = d.candidate.hypothesis.of_all_parameters(np.sqrt(np.maximum(np.diag(d.covariance), 0.0) * larger))
        for k, parameter in enumerate(d.candidate.hypothesis.effect.parameters()):
            if parameter.grid:
                bend = bent(contest, self.motion, d, parameter, present)
                out[k] = (
                    np.sqrt(larger / bend) if bend > 0 else abs(getattr(d.candidate.hypothesis.effect, parameter.name))
                )
        return out

    def _held_out(self, contest: Contest, candidate: Candidate, present: Sequence[Column]) -> float:
        """Nats that sizes from the other new recordings gain on each."""
        total = 0.0
        for one in contest.new:
            others = [r for r in contest.new if r != one]
            sized = contest.test(candidate, contest.baseline, others, present)
            total += contest.gained(candidate, sized.values, one, present)
        return total


def joint_of(effect: Effect, model: mujoco.MjModel) -> str | None:
    """Name of the joint that an effect acts at, None for bodies, the surroundings and sensors."""
    if isinstance(effect, ActuatorEffect):
        return str(model.joint(int(model.actuator(effect.where).trnid[0])).name)
    return effect.where if effect.kind == "joint" else None


def _dry_joint(ranked: Sequence[Ranked], motion: Motion) -> int | None:
    """Index of the joint at which dry friction changed most of all, if it did."""
    if not ranked or ranked[0].effect.kind != "joint":
        return None
    confusable = ranked[0].effect.confusable
    dry = confusable is not None and confusable.group == "dry friction"
    return int(motion.model.joint(ranked[0].effect.where).id) if dry else None


def _possible(difference: Difference) -> bool:
    """Whether physics allows the difference: what is left of a friction that fell is no drive."""
    hypothesis = difference.candidate.hypothesis
    if not hypothesis.coefficients and abs(np.rint(difference.values[0])) != 1:  # there or not
        return False
    deviations = np.sqrt(np.maximum(np.diag(difference.covariance), 0.0))
    rows = zip(hypothesis.coefficients, difference.values, difference.common, deviations, strict=False)
    for parameter, value, common, deviation in rows:
        least = parameter.low - parameter.absent
        if value < -3 * deviation and max(common, 0.0) + value < least - 3 * deviation:
            return False
    if isinstance(hypothesis.effect, AsymmetricFriction):  # less one way and more the other is a force
        less, more = np.any(difference.values < -3 * deviations), np.any(difference.values > 3 * deviations)
        return not (less and more)
    if isinstance(hypothesis.effect, PositionDependentFriction):
        mean, *waves = difference.values
        return bool(abs(mean) >= np.hypot(*waves))
    return True


def between_runs(contest: Contest, criteria: Criteria) -> dict[Key, float]:
    """Nats of each candidate when one run of the baseline after the other is taken for new, in the mean.

    What differs most from run to run by itself becomes a number of each run, with the spread that it shows in most; but
    motors stay as they are, and so does what needs several numbers, which make up for each other. Means are drawn
    towards that of all candidates, since there are few runs.
    """
    steady = {c.key for c in contest.candidates if isinstance(c.hypothesis.effect, ActuatorEffect) or c.columns[1:]}
    for _ in range(criteria.sizes.by_run):
        gains = _left_out(contest)
        means = {key: float(np.mean([gain for gain, _ in own])) for key, own in gains.items() if key not in steady}
        worst = max(means, key=means.__getitem__)
        if means[worst] < criteria.certain or len(contest.baseline) < 3:
            break
        candidate = contest.candidates[max(gains[worst])[1]]
        tested = [contest.test(candidate, [b for b in contest.baseline if b != r], [r]) for r in contest.baseline]
        size = np.median([d.values**2 for d in tested], axis=0)  # one run may be unlike the others
        p = contest.regression.shared.shape[2]
        contest.by_run += [(p + i, 1 / max(float(v), 1e-12)) for i, v in zip(candidate.columns, size, strict=True)]
    gains, few = _left_out(contest), 3
    mean = float(np.mean([gain for own in gains.values() for gain, _ in own]))
    return {key: (few * mean + sum(gain for gain, _ in own)) / (few + len(own)) for key, own in gains.items()}


def _left_out(contest: Contest) -> dict[Key, list[tuple[float, int]]]:
    """Nats and candidate, by effect and place, of each run of the baseline against the others."""
    contest.weigh(contest.baseline, ())
    out: dict[Key, list[tuple[float, int]]] = {}
    for run in contest.baseline:
        gains = contest.screen([b for b in contest.baseline if b != run], [run])
        order = sorted(range(len(gains)), key=lambda i: contest.candidates[i].key)
        for key, own in groupby(order, key=lambda i: contest.candidates[i].key):
            out.setdefault(key, []).append(max((float(gains[i]), i) for i in own))
    return out
