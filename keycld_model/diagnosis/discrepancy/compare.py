"""What changed between two sets of recordings: the stages in order."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.candidates import Columns
from keycld_model.diagnosis.discrepancy.changes import Contest, Key
from keycld_model.diagnosis.discrepancy.checks import check_enough, check_motion, check_overlap
from keycld_model.diagnosis.discrepancy.covariance import Discrepancy
from keycld_model.diagnosis.discrepancy.following import followed
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.overlap import beyond_baseline, comparable
from keycld_model.diagnosis.discrepancy.pushes import Push, Pushes
from keycld_model.diagnosis.discrepancy.regression import (
    Mask,
    Regression,
    Solution,
    whitened_again,
)
from keycld_model.diagnosis.discrepancy.regressors import Term
from keycld_model.diagnosis.discrepancy.selection import Change, Ranked, Selection, between_runs

RIGHT = 0.84
"""Share of first findings that were right on real recordings, by Laplace's rule: 47 of 55, of the 100 cases of
gate G1 on 25 November 2026 (docs/real-data.md, "before")."""


@dataclass(frozen=True)
class Comparison:
    """What two sets of recordings have in common, and what not.

    Attributes:
        motion: of both.
        terms: that both share.
        common: their values.
        changes: accepted differences.
        next_best: the best that was not accepted.
        inconsistent: it gains in some of the new recordings only.
        beyond: share of the time in which new recordings leave the range of the baseline, by channel.
        discrepancy: that nothing explains.
        contest: in which changes were tested.
        chance: nats that each candidate gains between runs of the baseline, by effect and place.
        pushes: in new recordings.
        faint: what most looks like a push, if anything does.
        selection: that found the changes.
    """

    motion: Motion
    terms: Sequence[Term]
    common: Solution
    changes: Sequence[Change]
    next_best: Ranked | None
    inconsistent: bool
    beyond: dict[str, float]
    discrepancy: Discrepancy
    contest: Contest
    chance: Mapping[Key, float]
    pushes: Sequence[Push]
    faint: Push | None
    selection: Selection

    @property
    def right(self) -> float:
        """Share of findings that were right on recordings in which effects had been concealed."""
        return RIGHT


def compare(
    recordings: Sequence[Recording],
    baseline: Sequence[Recording],
    model: mujoco.MjModel,
    criteria: Criteria,
    advance: Callable[..., None],
    leaves_out: Callable[[str], bool],
) -> Comparison:
    """Find what is different in recordings.

    Args:
        recordings: new ones.
        baseline: of the same mechanism before; see `checks.check_alike`.
        model: the simulator.
        criteria: thresholds.
        advance: of a progress bar of 100 steps.
        leaves_out: whether there is no time for something, which it then notes.

    Raises:
        InputError: if hardly anything moves in the new ones, or the excitations of both do not overlap.
    """
    advance(0, "following the motion")
    motion, terms, discrepancy = followed([*baseline, *recordings], len(baseline), model, criteria)
    of_baseline = motion.windows.recording < len(baseline)
    check_motion(motion, of_baseline)
    anywhere = beyond_baseline(motion, of_baseline)
    beyond = {channel: float(b[~of_baseline].mean()) for channel, b in anywhere.items()}
    check_overlap(beyond)
    within = comparable(anywhere, of_baseline)
    check_enough(within & ~of_baseline, ~of_baseline)
    advance(20, "columns of all effects")
    columns = Columns.of(motion)
    advance(10, "what the baseline leaves")
    found = whitened_again(motion, terms, columns.answers, of_baseline, discrepancy)
    advance(10, "looking for pushes")
    lasting = _Lasting(motion, terms, columns, found, discrepancy, len(baseline), within, criteria, leaves_out)
    pushes = None
    if not leaves_out("pushes"):
        pushes = _pushes_beside(motion, terms, found, discrepancy, len(baseline), criteria)
    given = pushes.found(()) if pushes else []
    faint = given[0] if given else None  # the one that stands out most
    if faint and faint.times < criteria.clear_push:
        given = []
    selection, changes, next_best, inconsistent = lasting.beside(given, advance)
    # what changed may be what seemed to be pushes
    if pushes and given and changes and not leaves_out("pushes beside what changed"):
        alone = len(recordings) == 1  # then nothing tells a push from what the form of a change leaves
        again = [] if alone else pushes.found([c.effect for c in changes])
        if lasting.pushed(again).tolist() != lasting.pushed(given).tolist():
            selection, changes, next_best, inconsistent = lasting.beside(again, lambda *_: None)
        given = again
    contest = selection.contest
    common = _common(contest.regression, terms, of_baseline)
    advance(10)
    left = selection.discrepancy
    return Comparison(
        motion,
        terms,
        common,
        changes,
        next_best,
        inconsistent,
        beyond,
        left,
        contest,
        selection.chance,
        given,
        faint,
        selection,
    )


def _pushes_beside(
    motion: Motion, terms: Sequence[Term], found: Regression, left: Discrepancy, baseline: int, criteria: Criteria
) -> Pushes | None:
    """Looks for pushes beside what both sets share; None where motors have states of their own."""
    if motion.model.na:
        return None
    everything = np.ones(len(motion.windows), dtype=np.bool_)
    values = found.solve(everything, found.shared[..., :0], np.zeros(0)).values
    by_name = {t.name: float(v) for t, v in zip(terms, values, strict=True)}
    return Pushes.of(motion, by_name, left, baseline, criteria)


@dataclass(frozen=True)
class _Lasting:
    """Looks for lasting changes, where nobody pushes.

    Attributes:
        motion: of both sets.
        terms: that both share.
        columns: of all candidates.
        found: their regression.
        discrepancy: that the baseline leaves.
        baseline: number of its recordings.
        within: `[W]` windows within the range of the baseline.
        criteria: thresholds.
        leaves_out: whether there is no time for something.
    """

    motion: Motion
    terms: Sequence[Term]
    columns: Columns
    found: Regression
    discrepancy: Discrepancy
    baseline: int
    within: Mask
    criteria: Criteria
    leaves_out: Callable[[str], bool]

    def pushed(self, pushes: Sequence[Push]) -> Mask:
        """`[W]` windows in which somebody pushes."""
        windows = self.motion.windows
        ends, out = windows.begun + windows.steps * windows.step, np.zeros(len(windows), dtype=np.bool_)
        for p in pushes:
            out |= (windows.recording == p.recording) & (windows.begun < p.start + p.duration) & (ends > p.start)
        return out

    def beside(
        self, pushes: Sequence[Push], advance: Callable[..., None]
    ) -> tuple[Selection, list[Change], Ranked | None, bool]:
        """The selection, its changes, the next best one, and whether that is in some of the new recordings only."""
        of_baseline = self.motion.windows.recording < self.baseline
        free = self.within & ~self.pushed(pushes)
        if np.count_nonzero(free & ~of_baseline) < self.criteria.sizes.unpushed:
            free = self.within
        zeros = [(i, term.spread) for i, term in enumerate(self.terms) if term.zero]
        recording, new = _halves(self.motion, self.baseline, free)
        contest = Contest(self.found, self.columns.candidates, recording, tuple(range(self.baseline)), new, zeros)
        advance(10, "how runs of the baseline differ")
        chance = between_runs(contest, self.criteria)
        advance(20, "testing differences")
        selection = Selection(
            self.motion, self.terms, self.columns, contest, self.discrepancy, of_baseline, self.criteria, chance
        )
        changes = selection.changes(advance, self.leaves_out)
        advance(20)
        return selection, *changes


def _common(found: Regression, terms: Sequence[Term], of_baseline: Mask) -> Solution:
    """Values of terms in the baseline, in which friction and motors have the simplest forms, which have names."""
    none = 1e12  # precision of what is not there
    simplest = replace(found, precision=np.where([term.beyond for term in terms], none, found.precision))
    nothing = np.zeros((int(of_baseline.sum()), found.target.shape[1], 0))
    return simplest.solve(of_baseline, nothing, np.zeros(0))


def _halves(motion: Motion, baseline: int, within: NDArray[np.bool_]) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Recording of each window, -1 where the baseline says nothing of it, and the new ones.

    A single new one is parted into two halves, of every second window, so that one can test the other: its end may be
    nothing like its start.
    """
    recording = np.where(within, motion.windows.recording, -1)
    new = [int(r) for r in np.unique(recording) if r >= baseline]
    if len(new) > 1:
        return recording, tuple(new)
    own = np.flatnonzero(recording == new[0])
    recording[own[1::2]] = new[0] + 1
    return recording, (new[0], new[0] + 1)
