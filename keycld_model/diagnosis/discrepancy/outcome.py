"""What a comparison means: findings with intervals, and rollouts with and without what changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from keycld_envs.effects import ConstantForce, CoulombFriction, Effect, ExternalPulse, ViscousFriction
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.checks import held_still
from keycld_model.diagnosis.discrepancy.compare import Comparison
from keycld_model.diagnosis.discrepancy.detectable import found_from
from keycld_model.diagnosis.discrepancy.rollouts import enough, error_over, fit_errors, rollouts, unexplained
from keycld_model.diagnosis.discrepancy.selection import Change
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.replay import replay
from keycld_model.diagnosis.inputs.ranges import notable
from keycld_model.diagnosis.output.words import changed_headline, in_sentence
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.evidence import evidence
from keycld_model.diagnosis.verdict.findings import Pushed, estimates, findings_of_pushes, nuisance_of
from keycld_model.diagnosis.verdict.report import Finding, FitErrors, Report, Verdict

IN_BOTH = 0.19
"""Confidence of what both sets have in common: it is fitted beside all that nobody modelled, and nothing cancels."""
PUSHES_RIGHT = 0.86
"""Share of pushes that were logged ones, by Laplace's rule: 17 of 19, of gate G2, before
one had to stand out clearly (docs/real-data.md)."""
NOT_BETTER = 0.17
"""Share of changes that were right where rollouts err more with them than without, by Laplace's rule: none of 4, of 60
cases of gate G1 and 22 of a stranger's (docs/notebook/2026-11-26-noisy-commands.md)."""
LEFT = (
    "In both sets, forces of {} are explained by nothing; a difference is only told from them where it is larger or "
    "lasts."
)


def report_of(
    found: Comparison,
    model: mujoco.MjModel,
    ids: Sequence[str],
    criteria: Criteria,
    not_tried: Sequence[str] = (),
) -> Report:
    """The report of a comparison.

    Args:
        found: the comparison.
        model: the simulator.
        ids: of the recordings of the baseline.
        criteria: thresholds.
        not_tried: what there was no time for; without it, nobody can say that nothing changed.
    """
    found, rolled, errors = _borne_out(found, _Rolled.of(found, model, criteria))
    runs = len(ids)
    right = found.right if errors.better else NOT_BETTER
    findings = [_finding(c, right, model, runs) for c in found.changes] + _pushes(found, model)
    perhaps = _perhaps(found, criteria)
    verdict = _verdict(found, errors, perhaps)
    if verdict == "no_mismatch" and not_tried:
        verdict = "undetermined"
    of_baseline = found.motion.windows.recording < runs
    still = [model.joint(int(j)).name for j in np.flatnonzero(held_still(found.motion, of_baseline))]
    seen = _friction_found(found, model, criteria, still) if verdict == "no_mismatch" else None
    return Report(
        verdict=verdict,
        headline=changed_headline(
            verdict,
            findings,
            errors,
            runs,
            perhaps,
            seen,
            not_tried,
            still,
            several=len(np.unique(found.motion.windows.recording)) - runs > 1,
            beyond=notable(found.beyond),
        ),
        findings=findings,
        nuisance=nuisance_of(rolled.refitted),
        unexplained=unexplained(found.motion, found.discrepancy, errors, LEFT),
        fit=errors,
        held_out=list(dict.fromkeys(found.motion.windows.ids[r] for r in found.motion.windows.recording[rolled.new])),
        baseline=list(ids),
        common=_common(found, model, runs),
        beyond_baseline=notable(found.beyond),
        details={**_details(found, rolled.refitted), "held_still": still},
        evidence=evidence(
            model,
            (rolled.before, rolled.after if errors.better else rolled.before),
            (rolled.before, rolled.after),
            of_sensors=False,
            baseline=rolled.refitted,
        ),
    )


def _borne_out(found: Comparison, rolled: "_Rolled") -> tuple[Comparison, "_Rolled", FitErrors]:
    """What was found, or a rival in its place with which rollouts are better, where with it they are not.

    Of two that are both borne out, rollouts do not tell the right one.
    """
    errors = rolled.errors(found)
    best = found, rolled, errors
    if not found.changes or errors.better:
        return best
    for change in found.selection.instead_of(found.changes[0]):
        other = replace(found, changes=[change], contest=found.selection.contest)
        tried = rolled.errors(other)
        if tried.better and tried.corrected < best[2].corrected:
            best = other, rolled.with_changes(other.changes), tried
    return best


def _perhaps(found: Comparison, criteria: Criteria) -> str | None:
    """What may have changed where too little speaks for it, in words; None if nothing does."""
    best = found.next_best
    if found.changes or found.pushes or found.inconsistent:
        return None
    if best is not None and best.times >= criteria.perhaps_changed:
        return f"{in_sentence(best.effect.id)} at {best.effect.where}"
    if found.faint is None:
        return None
    model = found.motion.model
    return f"{in_sentence(ExternalPulse.id)} at {model.joint(int(model.dof_jntid[found.faint.dof])).name}"


def _friction_found(
    found: Comparison, model: mujoco.MjModel, criteria: Criteria, still: Sequence[str]
) -> dict[str, str]:
    """Dry friction that would have been found, by joint that is not held still, in words."""
    contest, out = found.contest, {}
    for candidate in contest.candidates:
        effect = candidate.hypothesis.effect
        if effect.id == CoulombFriction.id:
            chance = found.chance.get(candidate.key, 0.0)
            (least,) = found_from(candidate, contest, contest.baseline, contest.new, chance, criteria)
            if np.isfinite(least) and effect.where not in still:
                (size,) = estimates(effect.with_parameters(c=float(least)), [0.0], model).values()
                out[effect.where] = f"{least:.2g} {size.unit}"
    return out


def _verdict(found: Comparison, errors: FitErrors, perhaps: str | None) -> Verdict:
    """Whether something changed: what does not hold in all new recordings, or hardly stands out, is undetermined."""
    if found.changes:
        return "mismatch" if errors.better or found.pushes else "undetermined"
    if found.pushes:
        return "mismatch"
    return "no_mismatch" if perhaps is None and not found.inconsistent else "undetermined"


def _finding(change: Change, right: float, model: mujoco.MjModel, runs: int) -> Finding:
    """A change as it is reported; such changes are right this often."""
    effect, times = change.effect, float(student.ppf(0.95, 3 + runs))
    everything = 1 + sum(weight for _, weight in change.rivals)
    same = [
        weight
        for rival, weight in change.rivals
        if (rival.effect.family, rival.effect.where) == (effect.family, effect.where)
    ]
    others = [(r.effect.id, r.effect.kind, r.effect.where) for r, _ in change.rivals]
    others += [o for o in effect.indistinguishable(model) if o not in others]
    return Finding.of(
        effect,
        estimates(effect, times * change.deviations, model),
        right / everything,
        others,
        family_confidence=right * (1 + sum(same)) / everything,
    )


def _pushes(found: Comparison, model: mujoco.MjModel) -> list[Finding]:
    """Pushes as they are reported, in the order of time."""
    windows = found.motion.windows
    starts = [float(np.asarray(r.t_state)[0]) for r in windows.recordings]
    pushed = [
        Pushed(p.dof, windows.ids[p.recording], (starts[p.recording] + p.start, starts[p.recording] + p.end), p.force)
        for p in sorted(found.pushes, key=lambda p: (p.recording, p.start))
    ]
    return findings_of_pushes(pushed, model, PUSHES_RIGHT)


def _common(found: Comparison, model: mujoco.MjModel, runs: int) -> list[Finding]:
    """What both sets have in common that the simulator lacks, as far as it is more than chance."""
    out, times = [], float(student.ppf(0.95, 3 + runs))
    for term, value, deviation in zip(found.terms, found.common.values, found.common.deviations, strict=True):
        if term.effect is None or abs(value) < 4 * deviation:
            continue
        (parameter,) = term.effect.parameters()
        if parameter.absent + value < parameter.low:
            continue
        effect = replace(term.effect, **{parameter.name: parameter.absent + float(value)})
        parameters = estimates(effect, [times * float(deviation)], model)
        out.append(Finding.of(effect, parameters, IN_BOTH, family_confidence=IN_BOTH))
    return out


def _details(found: Comparison, refitted: Fit) -> dict[str, object]:
    """Numbers of the comparison, JSON-compatible."""
    simulator = found.motion.problem.simulator
    return {
        "tracked": False,
        "gain_nats": round(sum(c.ranked.difference.gain for c in found.changes), 2),
        "held_out_gain_nats": round(sum(c.held_out for c in found.changes), 2),
        "times_chance": [round(c.ranked.times, 1) for c in found.changes],
        "next_best": None
        if found.next_best is None
        else {
            "effect": found.next_best.effect.id,
            "where": found.next_best.effect.where,
            "times_chance": round(found.next_best.times, 1),
        },
        "unexplained_force": found.discrepancy.force.tolist(),
        "noise": found.motion.noise.tolist(),
        "pushes": [
            {
                "recording": found.motion.windows.ids[p.recording],
                "joint": str(found.motion.model.joint(int(found.motion.model.dof_jntid[p.dof])).name),
                "start_s": round(p.start, 3),
                "end_s": round(p.end, 3),
                "force": round(p.force, 4),
                "deviation": round(p.deviation, 4),
                "times_chance": round(p.times, 2),
            }
            for p in found.pushes
        ],
        "windows": len(found.motion.windows),
        "step_s": simulator.step,
        "chi_square": {"refitted": refitted.chi_square},
    }


@dataclass(frozen=True)
class _Rolled:
    """Rollouts over windows of the new recordings.

    Attributes:
        new: `[W]` which windows are new, and in the range of the baseline.
        refitted: the simulator with nuisances and usual friction, fitted to the baseline.
        nominal: the simulator as it was, on new recordings.
        before: refitted, on new recordings.
        after: the same with what changed.
    """

    new: NDArray[np.bool_]
    refitted: Fit
    nominal: Fit
    before: Fit
    after: Fit

    @classmethod
    def of(cls, found: Comparison, model: mujoco.MjModel, criteria: Criteria) -> "_Rolled":
        """With initial states fitted in every window."""
        motion = found.motion
        everything = rollouts(motion, Simulator(model, motion.problem.simulator.step, criteria=criteria))
        of_baseline = np.isin(found.contest.recording, found.contest.baseline)
        problem = everything.take(enough(np.flatnonzero(of_baseline)))
        refitted = minimise(problem, problem.start(), 15)
        refitted = minimise(problem, refitted.point.with_effects(*_usual(model)), 15)
        new = np.isin(found.contest.recording, found.contest.new)
        after = everything.take(np.flatnonzero(new))
        start = replace(refitted, point=replace(refitted.point, variant=problem.start().variant))
        before = replay(after, refitted)
        return cls(new, refitted, replay(after, start), before, before).with_changes(found.changes)

    def with_changes(self, changes: Sequence[Change]) -> "_Rolled":
        """With these, in place of others."""
        if not changes:
            return replace(self, after=self.before)
        changed = _with_changes(self.refitted, [c.effect for c in changes])
        return replace(self, after=replay(self.before.problem, changed))

    def errors(self, found: Comparison) -> FitErrors:
        """Each half of the new recordings with sizes from the other one."""
        contest, corrected = found.contest, [self.before]
        if found.changes:
            corrected, recording = [], contest.recording[self.new]
            for k in range(2):
                test, sized = contest.new[k::2], contest.new[1 - k :: 2]
                effects = [change.sized(contest, sized) for change in found.changes]
                rows = np.flatnonzero(np.isin(recording, test))
                corrected.append(replay(self.before.problem.take(rows), _with_changes(self.refitted, effects)))
        errors = [error_over(fits) for fits in ([self.nominal], [self.before], corrected)]
        tested_on = "on new recordings, each half with sizes from the other"
        return fit_errors(self.before.problem, tested_on, errors)


def _usual(model: mujoco.MjModel) -> list[Effect]:
    """Friction and offsets that every joint has."""
    return [e for kind in (ViscousFriction, CoulombFriction, ConstantForce) for e in kind.candidates(model)]


def _with_changes(fit: Fit, effects: Sequence[Effect]) -> Fit:
    """A fit with differences: what it has already becomes more or less, within its bounds."""
    own = {e.key: e for e in fit.effects}
    for effect in effects:
        numbers = {p.name: getattr(effect, p.name) for p in effect.parameters()}
        before = own.get(effect.key)
        if before is not None:
            numbers = {name: getattr(before, name) + value for name, value in numbers.items()}
        own[effect.key] = effect.with_parameters(**numbers)
    return replace(fit, point=fit.point.with_effects(*own.values()))
