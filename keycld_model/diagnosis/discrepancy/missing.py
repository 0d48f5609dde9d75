"""What a simulator lacks, when much of what recordings show is explained by nothing: what helps in all of them.

Each set of effects is fitted to all recordings but one and tried on that one, in turn; forces that nothing explains are
as large as they are beside everything that might be missing, whatever is tried. An effect that every joint may have,
such as dry friction, is tried at all joints at once, too, since one alone is of no use where both are missing.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from keycld_envs.effects import ActuatorGain, Effect
from keycld_envs.effects.places import ActuatorEffect
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.candidates import Columns
from keycld_model.diagnosis.discrepancy.changes import Key
from keycld_model.diagnosis.discrepancy.covariance import Discrepancy
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regression import regression, robust_weights
from keycld_model.diagnosis.discrepancy.regressors import Term, share_of_torque
from keycld_model.diagnosis.search.hypotheses import Hypothesis

Array = NDArray[np.float64]
KEPT = 4
"""Sets of each size that are continued."""
RIVALS = 0.5
"""Share of a gain from which something else is looked at in its place."""


@dataclass(frozen=True)
class Group:
    """An effect at one place, or at all of its places.

    Attributes:
        members: one hypothesis per place.
        columns: indices of the columns of each.
    """

    members: tuple[Hypothesis, ...]
    columns: tuple[tuple[int, ...], ...]

    @property
    def keys(self) -> frozenset[Key]:
        """Effects and places."""
        return frozenset(member.key for member in self.members)

    @property
    def all_columns(self) -> tuple[int, ...]:
        """Of all places."""
        return tuple(i for own in self.columns for i in own)

    @property
    def numbers(self) -> int:
        """How many parameters it has."""
        return sum(len(member.effect.parameters()) for member in self.members)

    def together(self, other: "Group") -> "Group":
        """With the places of another one."""
        return Group((*self.members, *other.members), (*self.columns, *other.columns))


@dataclass(frozen=True)
class Tried:
    """A set of effects, held out from recording to recording.

    Attributes:
        groups: that it has.
        costs: `[R]` nats of each recording with parameters from the others.
        values: `[R, k]` coefficients without each recording.
    """

    groups: tuple[Group, ...]
    costs: Array
    values: Array

    def gained(self, before: "Tried") -> float:
        """Nats over another set."""
        return float(np.sum(before.costs - self.costs))

    def everywhere(self, before: "Tried", criteria: Criteria) -> bool:
        """Whether each recording is explained better than by another set, but for chance (Student's t)."""
        ratios = np.log(before.costs / self.costs)  # each recording weighs the same, however large its error
        least = float(student.ppf(1 - criteria.everywhere, len(ratios) - 1))
        spread = float(np.std(ratios, ddof=1)) / np.sqrt(len(ratios))
        return bool(np.mean(ratios) > least * spread and np.mean(ratios > 0) >= criteria.everywhere_share)

    def members(self) -> Iterator[tuple[Hypothesis, Array, Array]]:
        """Each hypothesis, its coefficients in the mean, and their standard deviations over recordings.

        One that is there or not has one coefficient, about one. Deviations are the jackknife's (Miller, 1974).
        """
        n, at = len(self.costs), 0
        values, deviations = self.values.mean(axis=0), np.sqrt((n - 1) * np.var(self.values, axis=0))
        for member in (member for group in self.groups for member in group.members):
            own = slice(at, at + max(1, len(member.coefficients)))
            yield member, values[own], deviations[own]
            at = own.stop

    def effects(self) -> list[Effect]:
        """With their coefficients in the mean."""
        return [member.effect.with_parameters(**member.numbers(values)) for member, values, _ in self.members()]


@dataclass
class Missing:
    """Finds what helps in all recordings.

    Attributes:
        motion: of the recordings.
        white: columns of inertias and zeros, of candidates and the target, `[W, r, P + C + 1]`.
        precision: `[P]` of the priors of inertias and zeros.
        fold: `[W]` what each window is held out with: its recording, or a part of it where there are few.
        groups: what may be missing.
        discrepancy: that nothing explains.
        criteria: thresholds.
        freedom: of each window.
    """

    motion: Motion
    white: Array
    precision: Array
    fold: NDArray[np.int64]
    groups: list[Group]
    discrepancy: Discrepancy
    criteria: Criteria
    freedom: int

    @classmethod
    def of(cls, motion: Motion, terms: Sequence[Term], columns: Columns, criteria: Criteria) -> "Missing":
        """All that may be missing along a motion, beside terms that all recordings share."""
        found, discrepancy = regression(motion, terms, columns.answers, np.ones(len(motion.windows), bool))
        own = [i for i, term in enumerate(terms) if term.effect is None and not term.beyond]
        white = np.concatenate([found.shared[..., own], found.others, found.target[..., None]], axis=-1)
        groups = [Group((c.hypothesis,), (c.columns,)) for c in columns.candidates if _plausible(c.hypothesis.effect)]
        fold = _folds(motion)
        return cls(motion, white, found.precision[own], fold, groups, discrepancy, criteria, found.freedom)

    def search(self, no_time: Callable[[str], bool]) -> tuple[list[Tried], Tried]:
        """The best sets of effects, the very best first, and none at all.

        Args:
            no_time: asked before each further effect whether there is no time for what is named.
        """
        none = self._tried([()], ())[0]
        kept, accepted = [none], []
        for number in range(self.criteria.sizes.effects):
            if number and no_time(f"sets of {number + 1} effects"):
                break
            following: dict[frozenset[Key], Tried] = {}
            for before in kept:
                for tried in self._continued(before):
                    if self._accepted(tried, before, none):
                        following.setdefault(frozenset(k for g in tried.groups for k in g.keys), tried)
            kept = sorted(following.values(), key=lambda t: self.score(t, none), reverse=True)[:KEPT]
            accepted += kept
            if not kept:
                break
        return sorted(accepted, key=lambda t: self.score(t, none), reverse=True), none

    def score(self, tried: Tried, none: Tried) -> float:
        """Nats gained, of which each number costs a share: forms are idealised, so that more of them always gain."""
        numbers = sum(group.numbers for group in tried.groups)
        return tried.gained(none) * (1 - self.criteria.idealised_share * numbers)

    def alternatives(self, best: Tried, group: Group) -> list[tuple[Group, float]]:
        """What does as well in a group's place, and the share of the group's gain that it has."""
        rest = tuple(g for g in best.groups if g is not group)
        without = self._tried([()], rest)[0]
        least, out = best.gained(without), []
        for tried in self._continued(without):
            (new,) = [g for g in tried.groups if g not in rest]
            share = tried.gained(without) / least
            if new.keys != group.keys and share > RIVALS and self._possible(tried) and self._driven(tried):
                out.append((new, share))
        return sorted(out, key=lambda pair: pair[1], reverse=True)

    def _accepted(self, tried: Tried, before: Tried, none: Tried) -> bool:
        least = self.criteria.further_missing * max(before.gained(none), 0.0)
        return (
            self._possible(tried)
            and tried.gained(before) > max(least, self.criteria.certain)
            and self.score(tried, none) > self.score(before, none)
            and tried.everywhere(before, self.criteria)
            and self._driven(tried)
        )

    def _driven(self, tried: Tried) -> bool:
        """Whether motors still do most of what they are told.

        One that does not is broken, and stands for friction that its commands make up for.
        """
        for effect in tried.effects():
            if isinstance(effect, ActuatorEffect) and not effect.forces:
                everywhere = np.ones(len(self.motion.windows), bool)
                if share_of_torque(self.motion, effect, everywhere) > self.criteria.motor_share:
                    return False
        return True

    def _possible(self, tried: Tried) -> bool:
        """Whether all parameters are within their bounds, but for chance."""
        for member, values, deviations in tried.members():
            if not member.coefficients and np.rint(values[0]) != 1:  # there or not
                return False
            for parameter, value, deviation in zip(member.coefficients, values, deviations, strict=False):
                least, most = parameter.low - 2 * deviation, parameter.high + 2 * deviation
                if not least <= parameter.absent + value <= most:
                    return False
        return True

    def _continued(self, before: Tried) -> list[Tried]:
        """With one more effect, at one place or at all; of each effect at a place with the values that gain most."""
        taken = {key for group in before.groups for key in group.keys}
        free = [group for group in self.groups if not group.keys & taken]
        best: dict[frozenset[Key], Tried] = {}
        for tried in self._tried([(group,) for group in free], before.groups):
            key = tried.groups[-1].keys
            if key not in best or tried.costs.sum() < best[key].costs.sum():
                best[key] = tried
        singles = sorted((t.groups[-1] for t in best.values()), key=_effect)
        everywhere = []
        for _, own in groupby(singles, key=_effect):
            first, *others = own
            if others:
                for other in others:
                    first = first.together(other)
                everywhere.append((first,))
        return [*best.values(), *self._tried(everywhere, before.groups)]

    def _tried(self, sets: Sequence[tuple[Group, ...]], beside: tuple[Group, ...]) -> list[Tried]:
        """Sets of groups beside others, each held out from fold to fold."""
        p = len(self.precision)
        present = [*range(p), *(p + i for group in beside for i in group.all_columns)]
        used = [*present, self.white.shape[-1] - 1]
        weights = robust_weights(self.white[..., used], self._prior(len(used) - 1), self.freedom)
        rows = self.white * np.sqrt(weights)[:, None, None]
        grams = np.stack(
            [(flat := rows[self.fold == f].reshape(-1, rows.shape[-1])).T @ flat for f in range(self.fold.max() + 1)]
        )
        return [self._held_out(grams, present, own, beside) for own in sets]

    def _held_out(self, grams: Array, present: list[int], own: tuple[Group, ...], beside: tuple[Group, ...]) -> Tried:
        p = len(self.precision)
        columns = [*present, *(p + i for group in own for i in group.all_columns)]
        index, target = np.array([*columns, -1]), len(columns)
        each = grams[:, index[:, None], index]
        rest = each.sum(axis=0) - each
        matrix = rest[:, :target, :target] + np.diag(self._prior(target))
        scale = np.sqrt(np.maximum(np.einsum("rii->ri", matrix), 1e-300))
        scaled = matrix / scale[:, :, None] / scale[:, None, :] + 1e-10 * np.eye(target)
        values = np.linalg.solve(scaled, (rest[:, :target, target] / scale)[..., None])[..., 0] / scale
        costs = 0.5 * (
            each[:, target, target]
            - 2 * np.einsum("rc,rc->r", each[:, :target, target], values)
            + np.einsum("rc,rcd,rd->r", values, each[:, :target, :target], values)
        )
        return Tried((*beside, *own), np.maximum(costs, 1e-9), values[:, p:])

    def _prior(self, columns: int) -> Array:
        """Precisions of inertias and zeros, and of coefficients, of which nothing is known."""
        return np.concatenate([self.precision, np.zeros(columns - len(self.precision))])


def _effect(group: Group) -> str:
    return type(group.members[0].effect).__name__


def _plausible(effect: Effect) -> bool:
    """Whether an effect could be told from masses, which are fitted beside it."""
    return effect.family != "inertia" and not isinstance(effect, ActuatorGain)


def _folds(motion: Motion) -> NDArray[np.int64]:
    """A fold per recording; fewer than six are parted in time, with as many windows with motion in each part."""
    recording = np.unique(motion.windows.recording, return_inverse=True)[1]
    count, fewest = int(recording.max()) + 1, 6
    if count >= fewest:
        return recording
    parts, fold, moves = -(-fewest // count), np.zeros(len(recording), np.int64), motion.moves
    for r in range(count):
        own = recording == r
        before = np.cumsum(moves[own]) - moves[own]
        fold[own] = r * parts + np.minimum(before * parts // max(int(moves[own].sum()), 1), parts - 1)
    return np.unique(fold, return_inverse=True)[1]
