"""What recordings lack of a simulator whose misfit is far above noise, with nothing to compare them with."""

from collections.abc import Callable, Iterator, Sequence
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
from keycld_model.diagnosis.discrepancy.outcome import MODEL_ERROR, unexplained_force
from keycld_model.diagnosis.discrepancy.regression import robust_squares
from keycld_model.diagnosis.discrepancy.regressors import Term, shared_terms
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.replay import error_unit, replay, rollout_error
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.output.words import headline
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.evidence import evidence
from keycld_model.diagnosis.verdict.findings import estimate, nuisance_of
from keycld_model.diagnosis.verdict.report import Finding, FitErrors, Report, Unexplained

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
WINDOWS = 120
"""Windows of a fit at most."""
RIGHT = 0.5
"""Share of such findings that are right: not counted yet, and taken for one half until it is."""


def lacking(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    model: mujoco.MjModel,
    criteria: Criteria,
    advance: Callable[..., None],
) -> Report | None:
    """The report of what helps in all recordings; None if they are not far above noise, or nothing does.

    Args:
        recordings: to learn from.
        held_out: to test on; if there are none, each half of the recordings is tested with parameters from the other.
        model: the simulator.
        criteria: thresholds.
        advance: of a progress bar of 100 steps.
    """
    advance(0, "following the motion")
    motion = Motion.of([*recordings, *held_out], model, criteria)
    learned = motion.take(np.flatnonzero(motion.windows.recording < len(recordings)))
    terms, columns = shared_terms(learned, criteria, held=True), Columns.of(learned)
    if not _far_above_noise(learned, terms, columns, criteria):
        return None
    advance(20, "what nothing explains")
    missing = Missing.of(learned, terms, columns, criteria)
    advance(30, "what helps in all recordings")
    sets, none = missing.search()
    advance(20, "fitting what was found")
    if not sets:
        return None
    best = sets[0]
    rolled = _Rolled.of(motion, len(recordings), model, best.effects(), criteria)
    findings = _findings(missing, best, rolled.corrected, model)
    errors = rolled.errors
    clear = min((f.family_confidence or 0.0) for f in findings) > RIGHT / 2
    verdict = "mismatch" if clear and errors.corrected < errors.refitted else "undetermined"
    left = _unexplained(missing, errors, model)
    advance(30)
    return Report(
        verdict=verdict,
        headline=headline(verdict, findings, errors, left),
        findings=findings,
        nuisance=nuisance_of(rolled.corrected),
        unexplained=left,
        fit=errors,
        held_out=[motion.windows.ids[r] for r in sorted(set(motion.windows.recording[rolled.tested]))],
        details={
            "gain_nats": round(best.gained(none), 2),
            "folds": len(best.costs),
            "unexplained_force": missing.discrepancy.force.tolist(),
            "noise": motion.noise.tolist(),
            "windows": len(motion.windows),
            "step_s": motion.problem.simulator.step,
        },
        evidence=evidence(
            model, (rolled.refitted, rolled.corrected), (rolled.refitted, rolled.corrected), of_sensors=False
        ),
    )


def _far_above_noise(motion: Motion, terms: Sequence[Term], columns: Columns, criteria: Criteria) -> bool:
    """Whether a quarter of the windows stay far above the sensors' noise, whatever is fitted to first order.

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
    squares = robust_squares(rest, rest.shape[1] - basis.shape[2])
    return bool(np.percentile(squares, 75) > criteria.far_above_noise)


def _findings(missing: Missing, best: Tried, fit: Fit, model: mujoco.MjModel) -> list[Finding]:
    """One per effect and place, as fitted to rollouts, with what does as well in its place."""
    fitted, deviations = {e.key: e for e in fit.effects}, iter(_with_gaps(best))
    by_regression = {e.key: e for e in best.effects()}
    times, out = float(student.ppf(0.95, len(best.costs) - 1)), []
    for group in best.groups:
        alternatives = missing.alternatives(best, group)
        for member in group.members:
            effect, before = fitted[member.key], by_regression[member.key]
            parameters = {}
            for p in effect.parameters():
                value, own = float(getattr(effect, p.name)), 0.0 if p.grid else next(deviations)
                spread = np.hypot(own, value - float(getattr(before, p.name)))  # two ways to size it, which may differ
                parameters[p.name] = estimate(effect, p, value, times * float(spread), model)
            confidence, of_family, rivals = _rivals(effect, group, alternatives, missing.criteria)
            out.append(
                Finding(
                    effect=effect.id,
                    family=effect.family,
                    where={"kind": effect.kind, "name": effect.where},
                    parameters=parameters,
                    equation=effect.equation,
                    confidence=round(RIGHT * confidence, 4),
                    family_confidence=round(RIGHT * of_family, 4),
                    rivals=[rival.id for rival in rivals],
                    rivals_where=[{"kind": rival.kind, "name": rival.where} for rival in rivals],
                )
            )
    return out


def _with_gaps(best: Tried) -> Iterator[float]:
    """Deviations of the coefficients, without those of effects that are there or not."""
    at, deviations = 0, best.deviations()
    for group in best.groups:
        for member in group.members:
            yield from deviations[at : at + len(member.coefficients)]
            at += max(1, len(member.coefficients))


def _rivals(
    effect: Effect, group: Group, alternatives: Sequence[tuple[Group, float]], criteria: Criteria
) -> tuple[float, float, list[Effect]]:
    """Weight of an effect among what does as well in its place, weight of its family, and the rivals themselves."""
    share = criteria.idealised_share
    own, same, everything, out = 1 - share * group.numbers, 1.0, 1.0, []
    for other, gained in alternatives:
        weight = float(np.exp((gained * (1 - share * other.numbers) - own) / share))
        here = [m.effect for m in other.members if m.effect.where == effect.where]
        everything += weight
        if here and here[0].family == effect.family:
            same += weight
        if gained >= 1 - criteria.rival_share:
            out += [e for e in here or [m.effect for m in other.members] if e.key not in {r.key for r in out}]
    return 1 / everything, same / everything, out


def _unexplained(missing: Missing, errors: FitErrors, model: mujoco.MjModel) -> Unexplained:
    """What is left."""
    worst, sizes = unexplained_force(missing.motion, missing.discrepancy, model)
    fraction = float(np.clip((errors.corrected / max(errors.refitted, 1e-12)) ** 2, 0, 1))
    message = f"Forces of {sizes} are explained by nothing; what is found helps in all recordings beside them."
    return Unexplained(True, round(fraction, 4), worst, message)


@dataclass(frozen=True)
class _Rolled:
    """Fits to rollouts over windows.

    Attributes:
        refitted: masses, lengths and zeros alone.
        corrected: with what was found.
        errors: on recordings that parameters were not fitted to.
        tested: windows of these.
    """

    refitted: Fit
    corrected: Fit
    errors: FitErrors
    tested: Rows

    @classmethod
    def of(
        cls, motion: Motion, recordings: int, model: mujoco.MjModel, effects: Sequence[Effect], criteria: Criteria
    ) -> "_Rolled":
        """With initial states fitted in every window."""
        simulator = Simulator(model, motion.problem.simulator.step, criteria=criteria)
        observation = JointPositions(model, np.maximum(motion.noise, MODEL_ERROR), criteria=criteria)
        problem = Problem(simulator, replace(motion.windows, observation=observation))
        recording, everything = motion.windows.recording, np.arange(len(motion.windows))
        new = everything[recording >= recordings]
        old = everything[recording < recordings]
        parts = [(old, new)] if len(new) else [(old[h], old[~h]) for h in _halves(recording[old])]
        squares, count = np.zeros(3), 0
        for learned, tested in parts:
            part, fits = problem.take(_some(tested)), _fits(problem.take(_some(learned)), effects)
            there = np.isfinite(part.windows.measured).sum()
            squares += [rollout_error(replay(part, fit)) ** 2 * there for fit in fits]
            count += there
        _, refitted, corrected = _fits(problem.take(_some(old)), effects)
        windows = problem.windows
        seconds = float(np.median(windows.time[:, -1] - windows.time[:, 0]))
        errors = FitErrors(
            f"root mean square of rollouts over {seconds:.2g} s with fitted initial states, on recordings that "
            "parameters were not fitted to",
            error_unit(observation.units),
            *(round(1e3 * float(error), 4) for error in np.sqrt(squares / count)),
        )
        return cls(refitted, corrected, errors, np.concatenate([tested for _, tested in parts]))


def _halves(recording: Rows) -> list[NDArray[np.bool_]]:
    """Every second recording, and the others; of a single one, its halves."""
    ids = np.unique(recording)
    half = np.isin(recording, ids[::2]) if len(ids) > 1 else np.arange(len(recording)) < len(recording) // 2
    return [half, ~half]


def _some(rows: Rows) -> Rows:
    """As many as are needed."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), WINDOWS)).round().astype(int))]


def _fits(problem: Problem, effects: Sequence[Effect]) -> tuple[Fit, Fit, Fit]:
    """The simulator as it is, refitted, and with effects."""
    nominal = minimise(problem, problem.start(), 8, only_states=True)
    refitted = minimise(problem, nominal.point, 15)
    return nominal, refitted, minimise(problem, refitted.point.with_effects(*effects), 20)
