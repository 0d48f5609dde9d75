"""What recordings lack of a simulator whose misfit is far above noise, with nothing to compare them with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.candidates import Columns
from keycld_model.diagnosis.discrepancy.missing import Group, Missing, Tried
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regression import robust_squares
from keycld_model.diagnosis.discrepancy.regressors import Term, shared_terms
from keycld_model.diagnosis.discrepancy.rollouts import enough, error_over, fit_errors, rollouts, unexplained
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.replay import replay
from keycld_model.diagnosis.output.words import headline
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.evidence import evidence
from keycld_model.diagnosis.verdict.findings import estimates, nuisance_of
from keycld_model.diagnosis.verdict.report import Finding, FitErrors, Report

Rows = NDArray[np.int64]
RIGHT = 0.85
"""Share of such reports that are right, by Laplace's rule: of 25 from half of a mechanism's recordings, the other half
confirmed 22 in family and place (gate G8, docs/real-data.md)."""
LEAST_FREE = 0.1
"""Share of the samples of a window that is counted as free at least, however many numbers are fitted."""
LEFT = "Forces of {} are explained by nothing; what is found helps in all recordings beside them."


def lacking(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    model: mujoco.MjModel,
    criteria: Criteria,
    advance: Callable[..., None],
    no_time: Callable[[str], bool],
) -> Report | None:
    """The report of what helps in all recordings; None if they are not far above noise, or nothing does.

    Args:
        recordings: to learn from.
        held_out: to test on; if there are none, each half of the recordings is tested with parameters from the other.
        model: the simulator.
        criteria: thresholds.
        advance: of a progress bar of 100 steps.
        no_time: asked before each step that can be left out whether there is no time for what is named.
    """
    advance(0, "following the motion")
    motion = Motion.of([*recordings, *held_out], model, criteria)
    learned = motion.take(np.flatnonzero(motion.windows.recording < len(recordings)))
    terms, columns = shared_terms(learned, criteria, held=True), Columns.of(learned)
    if not _far_above_noise(learned, terms, columns, criteria):
        return None
    advance(10, "following the motion more closely")
    closer = _closer(motion, [*recordings, *held_out], model, criteria)
    if closer is not motion:
        motion, learned = closer, closer.take(np.flatnonzero(closer.windows.recording < len(recordings)))
        terms, columns = shared_terms(learned, criteria, held=True), Columns.of(learned)
    advance(10, "what nothing explains")
    missing = Missing.of(learned, terms, columns, criteria)
    advance(30, "what helps in all recordings")
    sets, none = missing.search(no_time)
    advance(20, "fitting what was found")
    if not sets:
        return None
    rolled = _Rolled.of(motion, len(recordings), model, sets[0].effects(), criteria)
    report = _report(missing, sets[0], sets[0].gained(none), rolled, model)
    advance(30)
    return report


def _report(missing: Missing, best: Tried, gained: float, rolled: "_Rolled", model: mujoco.MjModel) -> Report:
    """What the best set of effects, which gained so many nats, means."""
    findings = _findings(missing, best, rolled.corrected, model)
    motion, errors, fits = rolled.motion, rolled.errors, (rolled.refitted, rolled.corrected)
    likely = min((f.family_confidence or 0.0) for f in findings) > RIGHT / 2
    clear = likely and all(map(_told, best.effects(), findings))
    verdict = "mismatch" if clear and errors.better else "undetermined"
    left = unexplained(missing.motion, missing.discrepancy, errors, LEFT)
    return Report(
        verdict=verdict,
        headline=headline(verdict, findings, errors, left),
        findings=findings,
        nuisance=nuisance_of(rolled.corrected),
        unexplained=left,
        fit=errors,
        held_out=[motion.windows.ids[r] for r in sorted(set(motion.windows.recording[rolled.tested]))],
        details={
            "gain_nats": round(gained, 2),
            "folds": len(best.costs),
            "unexplained_force": missing.discrepancy.force.tolist(),
            "noise": motion.noise.tolist(),
            "windows": len(motion.windows),
            "step_s": motion.problem.simulator.step,
        },
        evidence=evidence(model, fits, fits, of_sensors=False),
    )


def _closer(motion: Motion, recordings: Sequence[Recording], model: mujoco.MjModel, criteria: Criteria) -> Motion:
    """The motion followed with forces, and in windows, half as long, if it is followed far better thus.

    Forces that grow with it would follow a vibration.
    """
    before, sizes = np.median(motion.misfit), criteria.sizes
    if before < 1.0:  # the sensors' noise
        return motion
    half = replace(sizes, window_beside_forces=sizes.window_beside_forces / 2, constant_force=sizes.constant_force / 2)
    closer = Motion.of(recordings, model, replace(criteria, sizes=half))
    grows = np.median(closer.usual_force, axis=0) > (1 + criteria.vibrates) * np.median(motion.usual_force, axis=0)
    return motion if np.median(closer.misfit) > before / 2 or np.any(grows) else closer


def _far_above_noise(motion: Motion, terms: Sequence[Term], columns: Columns, criteria: Criteria) -> bool:
    """Whether a quarter of the windows with motion stay far above noise, whatever is fitted to first order.

    Then no set of effects leaves noise, and a search that weighs them by noise takes long and tells nothing.
    """
    known, some = {term.effect.key for term in terms if term.effect is not None}, []
    for candidate in columns.candidates:  # once with any of its nonlinear parameters
        if candidate.key not in known:
            known.add(candidate.key)
            some += candidate.columns
    shared = np.stack([term.column for term in terms], axis=-1)
    white = np.concatenate([shared, columns.answers[..., some], motion.residual[..., None]], axis=-1)
    basis = np.linalg.qr(motion.states)[0]
    rest = white - basis @ (np.swapaxes(basis, 1, 2) @ white)
    samples, fitted = rest.shape[1], basis.shape[2] + (white.shape[2] - 1) / len(white)
    squares = robust_squares(rest, max(samples - fitted, LEAST_FREE * samples))
    return bool(np.percentile(squares[motion.moves], 75) > criteria.far_above_noise)


def _findings(missing: Missing, best: Tried, fit: Fit, model: mujoco.MjModel) -> list[Finding]:
    """One per effect and place, as fitted to rollouts, with what does as well in its place."""
    fitted, by_regression = {e.key: e for e in fit.effects}, {e.key: e for e in best.effects()}
    deviations = {member.key: member.of_all_parameters(own) for member, _, own in best.members()}
    times, out = float(student.ppf(0.95, len(best.costs) - 1)), []
    for group in best.groups:
        alternatives = missing.alternatives(best, group)
        for member in group.members:
            effect, before = fitted[member.key], by_regression[member.key]
            apart = [getattr(effect, p.name) - getattr(before, p.name) for p in effect.parameters()]
            spreads = np.hypot(deviations[member.key], apart)  # two ways to size it, which may differ
            confidence, of_family, rivals = _rivals(effect, group, alternatives, missing.criteria)
            out.append(
                Finding.of(
                    effect,
                    estimates(effect, times * spreads, model),
                    RIGHT * confidence,
                    [(rival.id, rival.kind, rival.where) for rival in rivals],
                    family_confidence=RIGHT * of_family,
                )
            )
    return out


def _rivals(
    effect: Effect, group: Group, alternatives: Sequence[tuple[Group, float]], criteria: Criteria
) -> tuple[float, float, list[Effect]]:
    """Weight of an effect among what does as well in its place, weight of its family, and the rivals themselves."""
    share = criteria.idealised_share
    own, same, everything, out = 1 - share * group.numbers, 1.0, 1.0, []
    for other, gained in alternatives:
        if effect.key in other.keys:  # at other places, too, or at fewer
            continue
        better = (gained * (1 - share * other.numbers) - own) / share
        weight = float(np.exp(min(better, 0.0)))  # what gains more was not accepted: it does not help everywhere
        here = [m.effect for m in other.members if m.effect.where == effect.where]
        everything += weight
        if here and here[0].family == effect.family:
            same += weight
        if gained >= 1 - criteria.rival_share:
            out += [e for e in here or [m.effect for m in other.members] if e.key not in {r.key for r in out}]
    return 1 / everything, same / everything, out


def _told(effect: Effect, finding: Finding) -> bool:
    """Whether the interval of any coefficient leaves out that the effect is absent."""
    numbers = [(p, finding.parameters[p.name]) for p in effect.parameters() if not p.grid]
    return not numbers or any(not e.low <= p.absent <= e.high for p, e in numbers)


@dataclass(frozen=True)
class _Rolled:
    """Fits to rollouts over windows.

    Attributes:
        motion: of the windows.
        refitted: masses, lengths and zeros alone.
        corrected: with what was found.
        errors: on recordings that parameters were not fitted to.
        tested: windows of these.
    """

    motion: Motion
    refitted: Fit
    corrected: Fit
    errors: FitErrors
    tested: Rows

    @classmethod
    def of(
        cls, motion: Motion, recordings: int, model: mujoco.MjModel, effects: Sequence[Effect], criteria: Criteria
    ) -> "_Rolled":
        """With initial states fitted in every window."""
        problem = rollouts(motion, Simulator(model, motion.problem.simulator.step, criteria=criteria))
        recording, everything = motion.windows.recording, np.arange(len(motion.windows))
        new = everything[recording >= recordings]
        old = everything[recording < recordings]
        parts = [(old, new)] if len(new) else [(old[h], old[~h]) for h in _halves(recording[old])]
        replayed = [
            [replay(problem.take(enough(tested)), fit) for fit in _fits(problem.take(enough(learned)), effects)]
            for learned, tested in parts
        ]
        _, refitted, corrected = _fits(problem.take(enough(old)), effects)
        tested_on = "on recordings that parameters were not fitted to"
        errors = fit_errors(problem, tested_on, [error_over(fits) for fits in zip(*replayed, strict=True)])
        return cls(motion, refitted, corrected, errors, np.concatenate([tested for _, tested in parts]))


def _halves(recording: Rows) -> list[NDArray[np.bool_]]:
    """Every second recording, and the others; of a single one, its halves."""
    ids = np.unique(recording)
    half = np.isin(recording, ids[::2]) if len(ids) > 1 else np.arange(len(recording)) < len(recording) // 2
    return [half, ~half]


def _fits(problem: Problem, effects: Sequence[Effect]) -> tuple[Fit, Fit, Fit]:
    """The simulator as it is, refitted, and with effects."""
    nominal = minimise(problem, problem.start(), 8, only_states=True)
    refitted = minimise(problem, nominal.point, 15)
    return nominal, refitted, minimise(problem, refitted.point.with_effects(*effects), 20)
