"""What a comparison means: findings with intervals, and rollouts with and without what changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from keycld_envs.effects import (
    ConstantForce,
    CoulombFriction,
    Effect,
    ViscousFriction,
)
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.compare import Comparison
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regression import Discrepancy
from keycld_model.diagnosis.discrepancy.selection import Change
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.replay import error_unit, replay, rollout_error
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.output.words import changed_headline, in_sentence
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.evidence import evidence
from keycld_model.diagnosis.verdict.findings import estimate, nuisance_of
from keycld_model.diagnosis.verdict.report import Finding, FitErrors, Report, Unexplained, Verdict

Array = NDArray[np.float64]
IN_BOTH = 0.19
"""Confidence of what both sets have in common: it is fitted beside all that nobody modelled, and nothing cancels."""
MODEL_ERROR = 3e-3
"""What simulators of real mechanisms err by over a window, rad or m; only the weight of outliers depends on it."""


def report_of(found: Comparison, model: mujoco.MjModel, ids: Sequence[str], criteria: Criteria) -> Report:
    """The report of a comparison.

    Args:
        found: the comparison.
        model: the simulator.
        ids: of the recordings of the baseline.
        criteria: thresholds.
    """
    rolled = _Rolled.of(found, model, criteria)
    errors = rolled.errors(found)
    runs = len(ids)
    findings = [_finding(c, found, model, runs) for c in found.changes]
    perhaps = _perhaps(found, criteria)
    verdict = _verdict(found, errors, perhaps)
    return Report(
        verdict=verdict,
        headline=changed_headline(verdict, findings, errors, runs, perhaps),
        findings=findings,
        nuisance=nuisance_of(rolled.refitted),
        unexplained=_unexplained(found, model, errors),
        fit=errors,
        held_out=list(dict.fromkeys(found.motion.windows.ids[r] for r in found.motion.windows.recording[rolled.new])),
        baseline=list(ids),
        common=_common(found, model, runs),
        beyond_baseline={o.channel: round(o.share, 4) for o in found.overlap if o.share > 0.02},
        details=_details(found, rolled.refitted),
        evidence=evidence(model, (rolled.before, rolled.after), (rolled.before, rolled.after), of_sensors=False),
    )


def _perhaps(found: Comparison, criteria: Criteria) -> str | None:
    """What may have changed where too little speaks for it, in words; None if nothing does."""
    best = found.next_best
    if found.changes or found.inconsistent or best is None or best.times < criteria.perhaps_changed:
        return None
    return f"{in_sentence(best.effect.id)} at {best.effect.where}"


def _verdict(found: Comparison, errors: FitErrors, perhaps: str | None) -> Verdict:
    """Whether something changed: what does not hold in all new recordings, or hardly stands out, is undetermined."""
    if found.changes:
        return "mismatch" if errors.corrected < errors.refitted else "undetermined"
    return "no_mismatch" if perhaps is None and not found.inconsistent else "undetermined"


def _finding(change: Change, found: Comparison, model: mujoco.MjModel, runs: int) -> Finding:
    """A change as it is reported."""
    effect, times = change.effect, float(student.ppf(0.95, 3 + runs))
    parameters = {}
    for parameter, deviation in zip(effect.parameters(), change.deviations, strict=True):
        value = float(getattr(effect, parameter.name))
        parameters[parameter.name] = estimate(effect, parameter, value, times * deviation, model)
    everything = 1 + sum(weight for _, weight in change.rivals)
    same = [
        weight
        for rival, weight in change.rivals
        if (rival.effect.family, rival.effect.where) == (effect.family, effect.where)
    ]
    others = [(r.effect.id, r.effect.kind, r.effect.where) for r, _ in change.rivals]
    others += [o for o in effect.indistinguishable(model) if o not in others]
    return Finding(
        effect=effect.id,
        family=effect.family,
        where={"kind": effect.kind, "name": effect.where},
        parameters=parameters,
        equation=effect.equation,
        confidence=round(found.right / everything, 4),
        family_confidence=round(found.right * (1 + sum(same)) / everything, 4),
        rivals=[rival for rival, _, _ in others],
        rivals_where=[{"kind": kind, "name": name} for _, kind, name in others],
    )


def _common(found: Comparison, model: mujoco.MjModel, runs: int) -> list[Finding]:
    """What both sets have in common that the simulator lacks, as far as it is more than chance."""
    out, times = [], float(student.ppf(0.95, 3 + runs))
    for term, value, deviation in zip(found.terms, found.common, found.deviations, strict=True):
        if term.effect is None or abs(value) < 4 * deviation:
            continue
        (parameter,) = term.effect.parameters()
        if parameter.absent + value < parameter.low:
            continue
        out.append(
            Finding(
                effect=term.effect.id,
                family=term.effect.family,
                where={"kind": term.effect.kind, "name": term.effect.where},
                parameters={
                    parameter.name: estimate(
                        term.effect, parameter, parameter.absent + float(value), times * float(deviation), model
                    )
                },
                equation=term.effect.equation,
                confidence=IN_BOTH,
                family_confidence=IN_BOTH,
                rivals=[],
            )
        )
    return out


def _unexplained(found: Comparison, model: mujoco.MjModel, errors: FitErrors) -> Unexplained:
    """What is left in both sets."""
    worst, sizes = unexplained_force(found.motion, found.discrepancy, model)
    message = (
        f"In both sets, forces of {sizes} are explained by nothing; a difference is only told from them where it is "
        "larger or lasts."
    )
    fraction = float(np.clip((errors.corrected / max(errors.refitted, 1e-12)) ** 2, 0, 1))
    return Unexplained(True, round(fraction, 4), worst, message)


def unexplained_force(motion: Motion, discrepancy: Discrepancy, model: mujoco.MjModel) -> tuple[str, str]:
    """The joint at which unknown forces are largest for its inertia, and their sizes at all joints in words."""
    length = float(np.median(motion.windows.end - motion.windows.start)) / motion.response.shape[-1]
    names = [model.joint(int(model.dof_jntid[dof])).name for dof in range(model.nv)]
    sizes = [f"{size:.2g} at {name}" for name, size in zip(names, discrepancy.force, strict=True)]
    worst = int(np.argmax(discrepancy.force / np.maximum(model.dof_M0, 1e-9)))
    return names[worst], f"{', '.join(sizes)} (N m or N, root mean square over {1e3 * length:.0f} ms)"


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
        simulator = Simulator(model, motion.problem.simulator.step, criteria=criteria)
        noise = np.maximum(motion.noise, MODEL_ERROR)
        windows = replace(motion.windows, observation=JointPositions(model, noise, criteria=criteria))
        of_baseline = np.isin(found.contest.recording, found.contest.baseline)
        some = np.flatnonzero(of_baseline)
        some = some[np.linspace(0, len(some) - 1, min(len(some), 120)).round().astype(int)]
        problem = Problem(simulator, windows.take(some))
        refitted = minimise(problem, problem.start(), 15)
        refitted = minimise(problem, refitted.point.with_effects(*_usual(model)), 15)
        new = np.isin(found.contest.recording, found.contest.new)
        after = Problem(simulator, windows.take(np.flatnonzero(new)))
        start = replace(refitted, point=replace(refitted.point, variant=problem.start().variant))
        changed = _with_changes(refitted, [c.effect for c in found.changes])
        before = replay(after, refitted)
        corrected = replay(after, changed) if found.changes else before
        return cls(new, refitted, replay(after, start), before, corrected)

    def errors(self, found: Comparison) -> FitErrors:
        """Each half of the new recordings with sizes from the other one."""
        corrected = rollout_error(self.before)
        if found.changes:
            contest = found.contest
            recording = contest.recording[self.new]
            squares = number = 0.0
            for k in range(2):
                test, sized = contest.new[k::2], contest.new[1 - k :: 2]
                effects = [change.sized(contest, sized) for change in found.changes]
                rows = np.flatnonzero(np.isin(recording, test))
                fit = replay(self.before.problem.take(rows), _with_changes(self.refitted, effects))
                there = np.isfinite(fit.problem.windows.measured).sum()
                squares, number = squares + rollout_error(fit) ** 2 * there, number + there
            corrected = float(np.sqrt(squares / number))
        windows = self.before.problem.windows
        seconds = float(np.median(windows.time[:, -1] - windows.time[:, 0]))
        errors = rollout_error(self.nominal), rollout_error(self.before), corrected
        return FitErrors(
            f"root mean square of rollouts over {seconds:.2g} s with fitted initial states, on new recordings, each "
            "half with sizes from the other",
            error_unit(windows.observation.units),
            *(round(1e3 * error, 4) for error in errors),
        )


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
