"""What may be said, by recordings that no fit has seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.replay import predicted, rollout_error
from keycld_model.diagnosis.search.criterion import Scored, dispersion
from keycld_model.diagnosis.search.explain import Explanation, with_pulses_paid
from keycld_model.diagnosis.search.residual_fit import ROUNDS, fit_residual_force, lengthened, residual_force_of
from keycld_model.diagnosis.verdict.findings import may_be_absent, residual_force_finding
from keycld_model.diagnosis.verdict.held_out import HeldOut
from keycld_model.diagnosis.verdict.report import Finding, Unexplained, Verdict
from keycld_model.rigid_body.residual_force import ResidualForce


@dataclass(frozen=True)
class Conclusion:
    """What held-out recordings say.

    Attributes:
        verdict: see `Report`.
        fit: the simulator to be handed back.
        tested: the same on windows of held-out recordings.
        findings: what it has.
        nats: that its named findings gain.
        ceiling: the refitted simulator with a residual force in their place.
    """

    verdict: Verdict
    fit: Fit
    tested: Fit
    findings: list[Finding]
    nats: float
    ceiling: Fit | None = None

    @property
    def unknown(self) -> bool:
        """A residual force is all that was found."""
        return bool(self.findings) and all(finding.effect == ResidualForce.id for finding in self.findings)


def settled(explained: Explanation, near: Sequence[Scored], held_out: HeldOut) -> Explanation:
    """With that set which all recordings say is best, of those `near` that training recordings hardly tell apart.

    Small errors that go with the pose, of positions that are read off frames above all, weigh as much there as two
    forms differ, and are others in other recordings.
    """

    def worth(scored: Scored) -> float:
        told = predicted(held_out.short(scored.fit)) / explained.search.dispersion
        return told - with_pulses_paid(scored)

    sets = {scored.keys: scored for scored in (explained.best, *near)}
    worths = {keys: worth(scored) for keys, scored in sets.items()}
    best, likeliest = explained.best.keys, max(worths, key=worths.__getitem__)
    if worths[likeliest] > worths[best] + explained.best.fit.problem.criteria.alike:
        best = likeliest
    return replace(explained, best=sets[best], leads={keys: worths[best] - told for keys, told in worths.items()})


def decide_on_named(explained: Explanation, found: list[Finding], before: Fit, held_out: HeldOut) -> Conclusion:
    """Whether effects and pulses are missing.

    Args:
        explained: by training recordings.
        found: all that may be missing.
        before: the refitted simulator on windows of held-out recordings.
        held_out: recordings.
    """
    after, criteria = held_out.short(explained.best.fit), before.problem.criteria
    nats = (predicted(after) - predicted(before)) / explained.search.dispersion
    if not found or explained.gain <= criteria.doubtful or explained.gain + nats <= criteria.doubtful:
        return Conclusion("no_mismatch", explained.refitted, before, [], nats)
    sure = nats > 0 and explained.gain + nats > criteria.certain
    return Conclusion("mismatch" if sure else "undetermined", explained.best.fit, after, found, nats)


def decide_on_residual(named: Conclusion, explained: Explanation, held_out: HeldOut, left: Unexplained) -> Conclusion:
    """A residual force beside the findings, or in place of them, if held-out recordings ask for it.

    Args:
        named: what was decided on effects and pulses.
        explained: by training recordings.
        held_out: recordings.
        left: what named effects leave of them.
    """
    refitted, rounds, criteria = explained.refitted, ROUNDS if left.significant else 2, named.fit.problem.criteria
    alone = explained.residual or fit_residual_force(refitted, rounds)
    beside = alone if named.fit is refitted else fit_residual_force(named.fit, rounds)
    tested = [held_out.short(fit) for fit in (beside, alone)]
    with_named, in_place = (predicted(fit) if residual_force_of(fit) else -np.inf for fit in tested)
    without = predicted(named.tested)
    factor = min(explained.search.dispersion, dispersion(beside), dispersion(alone))
    least = criteria.residual_force
    extra = (max(with_named, in_place) - without) / factor
    instead = in_place > max(without + least * factor, with_named - least * factor)
    if instead or extra > max(least, criteria.idealised_share * named.nats):
        fit = alone if instead else beside
        fit = lengthened(fit, held_out.as_long(refitted))
        if not named.findings or rollout_error(held_out.long(fit)) < rollout_error(held_out.long(named.fit)):
            if instead:  # named effects stood for a part of it
                named = replace(named, findings=[], nats=0.0)
            findings = [*named.findings, residual_force_finding(fit, extra / (extra + max(named.nats, 0.0)))]
            return Conclusion("mismatch", fit, tested[instead], findings, named.nats)
    return replace(doubted(named, left), ceiling=alone)


def doubted(named: Conclusion, left: Unexplained) -> Conclusion:
    """What was decided on named effects, undetermined where they leave more than they may, or may as well be absent."""
    most, absent = named.fit.problem.criteria.unexplained_share, [may_be_absent(f) for f in named.findings]
    doubtful = named.verdict == "no_mismatch" or left.fraction > most or (bool(absent) and all(absent))
    return replace(named, verdict="undetermined") if left.significant and doubtful else named


class Rollouts(NamedTuple):
    """Long rollouts over held-out recordings: of the simulator as it was, refitted, and as it is handed back."""

    nominal: Fit
    refitted: Fit
    corrected: Fit


def never_worse(concluded: Conclusion, explained: Explanation, held_out: HeldOut) -> tuple[Conclusion, Rollouts]:
    """What is handed back, which is the refitted simulator where findings make long rollouts worse.

    Findings that leave them worse than the simulator as it was stand for a refit that went astray, of a camera above
    all, and nothing is sure.
    """
    fits = replace(explained.refitted, point=explained.refitted.problem.start()), explained.refitted, concluded.fit
    rollouts = Rollouts(*(held_out.long(fit) for fit in fits))
    nominal, refitted, corrected = map(rollout_error, rollouts)
    verdict = "undetermined" if concluded.findings and corrected > min(nominal, refitted) else concluded.verdict
    if corrected <= refitted:
        return replace(concluded, verdict=verdict), rollouts
    kept = replace(concluded, fit=explained.refitted, verdict=verdict)
    return kept, rollouts._replace(corrected=rollouts.refitted)
