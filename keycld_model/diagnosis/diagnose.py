"""The whole diagnosis: refit, search, test on held-out recordings, report."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.estimation.fit import Fit, Linearisation, Problem
from keycld_model.diagnosis.estimation.pulses import concentrated, paid, pushed, spiked
from keycld_model.diagnosis.estimation.replay import error_unit, likelihood, replay, rollout_error
from keycld_model.diagnosis.inputs.checks import check, check_apart
from keycld_model.diagnosis.inputs.noise import noise
from keycld_model.diagnosis.inputs.prepare import SAMPLES, accurate_step, ready, split
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.search.residual_fit import ROUNDS, fit_residual_force, lengthened, residual_force_of
from keycld_model.diagnosis.search.search import LARGEST, Scored, Search, misfit, penalty
from keycld_model.diagnosis.simulation.contacts import without_contacts
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.evidence import evidence
from keycld_model.diagnosis.verdict.findings import (
    calibrated,
    findings_of,
    headline_of,
    nuisance_of,
    pulses_of,
    rival_name,
    significant,
    unexplained_of,
    unknown_of,
)
from keycld_model.diagnosis.verdict.next_experiment import next_experiment
from keycld_model.diagnosis.verdict.report import Finding, FitErrors, Report, Unexplained, Verdict

WINDOWS = 80
"""At most, for the search."""
OWN = 0.5
"""Share of the misfit with an accurate integrator below which the model's own is tried first."""
HORIZON = 4
"""Windows that a long rollout is as long as."""
CLEAR, DOUBTFUL = 10.0, 3.0
"""Nats that findings must gain, with their numbers paid for, to be certain, and to be mentioned."""
UNKNOWN, MATERIAL = 15.0, 0.02
"""Nats that a force without a name must gain on held-out recordings, and share of what named effects gained if it
stands beside them: its form is free, and may mend idealisations of theirs."""
FEW, HALVED = 8, 2
"""Windows that tell whether steps are short enough, and times that they are halved before the search."""
LEFT = 0.1
"""Share of the misfit that named effects may leave, for them to be certain."""
MOST_LEFT = 0.02
"""The same that pushes may leave: rectangles are idealised. Where they leave more, they may mend something else, as
they may if effects alone leave no ten times as much."""
EXCLUDED = ("external_pulse",)
"""Effects that have a search of their own."""


def diagnose(
    recordings: Sequence[Recording],
    model: mujoco.MjModel,
    held_out: Sequence[Recording] = (),
    tracked: bool = False,
) -> Report:
    """Find physics that a simulator lacks.

    Args:
        recordings: joint positions and commands; a third of them is held out unless `held_out` is given.
        model: the simulator, of hinges and slides.
        held_out: recordings to test findings on, of other amplitudes and inputs.
        tracked: positions were read off images of a camera, whose errors are refitted, too: a view askew, and a shutter
            that rolls.

    Returns:
        The report.

    Raises:
        InputError: if the recordings do not suit the model, or nothing can be learned from them.
    """
    check([*recordings, *held_out], model)
    training, test = (ready(part, model) for part in (recordings, held_out))
    training, test = (training, test) if held_out else split(training)
    check_apart(training, test)
    sigma, bare = noise(training), without_contacts(model, [*training, *test])
    with progress("Diagnosing", total=5) as advance:
        simulator = Simulator(bare, accurate_step(training), tracked=tracked)
        accurate = _accurate(_refit(simulator, training, sigma), training)
        own = _refit(Simulator(bare, tracked=tracked), training, sigma)
        advance(1, "searching")
        explained = _search(accurate, own, training)
        advance(1, "rivals")
        found = explained.findings(training)
        advance(1, "testing on held-out recordings")
        refitted, temper = explained.refitted, explained.search.temper
        trial = _Trial.of(refitted, test, sigma)
        before = trial.short(refitted)
        named = _named(explained, found, before, trial)
        unexplained = unexplained_of(before, named.tested, model)
        advance(1, "looking for what has no name")
        concluded = _unnamed(named, explained, trial, unexplained, training)
        nominal = replace(refitted, point=refitted.problem.start())
        rollouts = [trial.long(fit) for fit in (nominal, refitted, concluded.fit)]
        if rollout_error(rollouts[2]) > rollout_error(rollouts[1]):  # what is handed back is never the worse one
            verdict: Verdict = "undetermined" if concluded.findings else concluded.verdict
            concluded, rollouts[2] = replace(concluded, fit=refitted, verdict=verdict), rollouts[1]
        limits = rollouts if concluded.ceiling is None else [*rollouts, trial.long(concluded.ceiling)]
        doubts = explained.doubts(named.verdict == "undetermined") if named.findings else []
        proposed = next_experiment(explained.best.fit, doubts, training, trial.samples) if doubts else None
        errors = FitErrors(
            f"root mean square of rollouts over {trial.seconds:.2g} s with fitted initial states",
            error_unit(model),
            *(round(1e3 * rollout_error(fit), 4) for fit in limits),
        )
        advance(1)
    simulator = refitted.problem.simulator
    return Report(
        verdict=concluded.verdict,
        headline=headline_of(concluded.verdict, concluded.findings, errors, unexplained),
        findings=calibrated(concluded.findings, unexplained),
        nuisance=nuisance_of(concluded.fit),
        unexplained=unexplained,
        fit=errors,
        held_out=[r.id for r in test],
        next_experiment=proposed,
        details={
            "gain_nats": round(explained.gain, 2),
            "held_out_gain_nats": round(concluded.nats, 2),
            "chi_square": {"refitted": refitted.chi_square, "corrected": concluded.fit.chi_square},
            "temper": temper,
            "noise": sigma.tolist(),
            "windows": len(refitted.problem.windows),
            "step_s": simulator.step,
            "tracked": tracked,
            "integrator": mujoco.mjtIntegrator(simulator.model.opt.integrator).name,
        },
        evidence=evidence(model, (refitted, concluded.fit), (rollouts[1], rollouts[2]), (training, test)),
    )


@dataclass(frozen=True)
class _Explained:
    """What training recordings say.

    Attributes:
        search: for effects.
        refitted: nuisances alone.
        best: with effects or pushes.
        smooth: refitted, with a force without a name; None where it was not needed.
    """

    search: Search
    refitted: Fit
    best: Scored
    smooth: Fit | None

    @property
    def gain(self) -> float:
        """Nats of effects and pushes, with their numbers paid for."""
        return float(self.refitted.cost / self.search.temper - _paid(self.best))

    def findings(self, training: Sequence[Recording]) -> list[Finding]:
        """All that may be missing."""
        fit = self.best.fit
        if fit.point.variant.pulses:
            windows = cut(training, fit.problem.simulator.step, SAMPLES)
            if len(windows) > len(fit.problem.windows):  # pushes also where was not searched
                fit = replay(replace(fit.problem, windows=windows), fit)
        return [*findings_of(self.best, self.rivals, self.search), *pulses_of(fit, training)]

    @cached_property
    def rivals(self) -> dict[tuple[str, str], list[Scored]]:
        """See `Search.rivals`."""
        return self.search.rivals(self.best)

    def doubts(self, nothing: bool) -> list[tuple[str, Fit]]:
        """Rivals of the best set by name, and the refitted simulator if `nothing` may be missing."""
        out = [("nothing", self.refitted)] if nothing else []
        for effect in self.best.fit.effects:
            for s in self.rivals[effect.key]:
                other = next(e for e in s.fit.effects if e.key not in self.best.keys)
                out.append((rival_name(other, effect), s.fit))
        return out


@dataclass(frozen=True)
class _Conclusion:
    """What held-out recordings say.

    Attributes:
        verdict: see `Report`.
        fit: the simulator to be handed back.
        tested: the same on windows of held-out recordings.
        findings: what it has.
        nats: that its named findings gain.
        ceiling: the refitted simulator with a force without a name in their place.
    """

    verdict: Verdict
    fit: Fit
    tested: Fit
    findings: list[Finding]
    nats: float
    ceiling: Fit | None = None


def _named(explained: _Explained, found: list[Finding], before: Fit, trial: "_Trial") -> _Conclusion:
    """Of effects and pushes; `before` is the refitted simulator on windows of held-out recordings."""
    after = trial.short(explained.best.fit)
    nats = (likelihood(after) - likelihood(before)) / explained.search.temper
    if not found or explained.gain <= DOUBTFUL:
        return _Conclusion("no_mismatch", explained.refitted, before, [], nats)
    sure = explained.gain > CLEAR and nats > 0
    return _Conclusion("mismatch" if sure else "undetermined", explained.best.fit, after, found, nats)


def _unnamed(
    named: _Conclusion, explained: _Explained, trial: "_Trial", left: Unexplained, training: Sequence[Recording]
) -> _Conclusion:
    """A force without a name beside the findings, or in place of them, if held-out recordings ask for it."""
    refitted, rounds = explained.refitted, ROUNDS if left.significant else 2
    alone = explained.smooth or fit_residual_force(refitted, rounds)
    smooth = alone if named.fit is refitted else fit_residual_force(named.fit, rounds)
    tested = [trial.short(fit) for fit in (smooth, alone)]
    beside, without = (likelihood(fit) if residual_force_of(fit) else -np.inf for fit in tested)
    without_force = likelihood(named.tested)
    temper = min(explained.search.temper, misfit(smooth), misfit(alone))
    extra = (max(beside, without) - without_force) / temper
    instead = without > max(without_force + UNKNOWN * temper, beside - UNKNOWN * temper)
    if instead or extra > max(UNKNOWN, MATERIAL * named.nats):
        fit = lengthened(alone if instead else smooth, trial.lengthened(training))
        if not named.findings or rollout_error(trial.long(fit)) < rollout_error(trial.long(named.fit)):
            if instead:  # named effects stood for a part of it
                named = replace(named, findings=[], nats=0.0)
            findings = [*named.findings, unknown_of(fit, extra / (extra + max(named.nats, 0.0)))]
            return _Conclusion("mismatch", fit, tested[instead], findings, named.nats)
    if left.significant and (named.verdict == "no_mismatch" or left.fraction > LEFT):
        named = replace(named, verdict="undetermined")
    return replace(named, ceiling=alone)


def _refit(simulator: Simulator, recordings: Sequence[Recording], sigma: NDArray[np.float64]) -> Fit:
    """Nuisances alone."""
    problem = _problem(simulator, recordings, sigma)
    return problem.minimise(problem.start(), iterations=15)


def _problem(simulator: Simulator, recordings: Sequence[Recording], sigma: NDArray[np.float64]) -> Problem:
    """Of recordings in windows."""
    windows = cut(recordings, simulator.step, SAMPLES)
    if len(windows) > WINDOWS:
        windows = windows.take(np.linspace(0, len(windows) - 1, WINDOWS).round().astype(int))
    return Problem(simulator, windows, sigma)


def _search(accurate: Fit, own: Fit, recordings: Sequence[Recording]) -> _Explained:
    """With the integrator that is right: an accurate one for nature, its own for a simulation of the model itself."""
    first, second = (own, accurate) if own.excess < OWN * accurate.excess else (accurate, own)
    explained = _explain(first, recordings)
    best = explained.best.fit
    if best.point.variant.pulses:
        return explained
    rival = min(second.cost, second.problem.minimise(second.point.with_effects(*best.effects)).cost)
    return _explain(second, recordings) if rival < best.cost - 1 else explained


def _accurate(refitted: Fit, recordings: Sequence[Recording]) -> Fit:
    """With steps so short that commands which jump within them do no harm."""
    for _ in range(HALVED):
        if coarseness(refitted, recordings) < DOUBTFUL:
            break
        simulator = refitted.problem.simulator
        refitted = _refit(simulator.with_step(simulator.step / 2), recordings, refitted.problem.noise)
    return refitted


def _finer(refitted: Fit, search: Search, best: Scored, recordings: Sequence[Recording]) -> tuple[Fit, Fit] | None:
    """Two fits with steps half as long, if the best explains more with them, or a set like it does.

    Stiff springs, stops and rotors need them, and what differs by what happens within a step: a lag, and a delay.
    """
    temper, simulator, alike = misfit(best.fit), best.fit.problem.simulator, search.alike(best)
    if not alike and coarseness(best.fit, recordings) < DOUBTFUL * temper:
        return None
    problem = _problem(simulator.with_step(simulator.step / 2), recordings, best.fit.problem.noise)
    fine, *others = (problem.minimise(replay(problem, s.fit).point) for s in (best, *alike))
    worth = [fit.cost / temper + penalty(fit) for fit in (fine, *others)]
    if min(worth) < worth[0] - DOUBTFUL:
        fine = others[int(np.argmin(worth)) - 1]
    elif fine.cost > best.fit.cost - DOUBTFUL * temper:
        return None
    return problem.minimise(replay(problem, refitted).point, iterations=15), fine


def coarseness(fit: Fit, recordings: Sequence[Recording]) -> float:
    """Nats by which steps half as long change what a fit predicts, beyond its initial states, from a few windows.

    Both in MuJoCo: nothing is compiled for this.
    """
    some = np.unique(np.linspace(0, len(fit.problem.windows) - 1, FEW).round().astype(int))
    part, point, simulator = fit.problem.take(some), fit.point.take(some), fit.problem.simulator
    coarse, fine = (simulator.with_step(step, compiled=False) for step in (simulator.step, simulator.step / 2))
    coarse = replace(part, simulator=coarse)
    fine = replace(part, simulator=fine, windows=part.windows.halved(recordings))
    residual, states = coarse.roll([point.variant], point)
    change = Linearisation(fine.residual(point) - residual[0], states, residual[0][..., None])
    left = change.project(change.residual[..., None])
    return 0.5 * float(np.sum(left**2)) * len(fit.problem.windows) / len(some)


def _explain(refitted: Fit, recordings: Sequence[Recording], effects: Sequence[Effect] = ()) -> _Explained:
    """The best set of effects and pushes with one integrator, with some effects to start from.

    Where these need shorter steps, the search goes on with such. Pushes only where neither effects nor a smooth force
    on the joints, which would come again in the same states, leave only noise, or where they do so but for few windows.
    Where pushes alone explain nearly all, rotors are not looked for from many starts.
    """
    search = Search(refitted.problem, EXCLUDED)
    likely = pushed(refitted) if concentrated(refitted) else refitted
    struck = bool(likely.point.variant.pulses) and likely.excess < MOST_LEFT * refitted.excess
    search.settled = bool(effects) or struck
    best, smooth = search.run(refitted.point, effects), None
    coarse = not refitted.problem.simulator.own and not effects
    if coarse and best.fit.effects and (finer := _finer(refitted, search, best, recordings)):
        return _explain(finer[0], recordings, finer[1].effects)
    if significant(best.fit).max() > 0:
        smooth = fit_residual_force(refitted)
    spoiled = spiked(best.fit) if smooth is None else significant(smooth).max() > 0
    if spoiled:
        spoilt = [refitted, best.fit]
        for fit in spoilt:
            start = likely if fit is refitted else pushed(fit) if concentrated(fit) else fit
            if not start.point.variant.pulses:
                continue
            other = Search(refitted.problem, EXCLUDED, LARGEST - 1, refitted.cost - start.cost)
            found = _without_pulses(other.run(start.point, start.effects))
            most = min(MOST_LEFT * refitted.excess, LEFT * best.fit.excess)
            filler = found.fit.point.variant.pulses and significant(found.fit).max() > 0 and found.fit.excess > most
            if filler and fit is refitted and found.fit.effects:  # found beside effects, pushes may be others
                spoilt.append(_bare(found.fit))
            if not filler and _paid(found) < _paid(best) - search.least(best):
                search, best = other, found
                break
    return _Explained(search, refitted, search.soften(best), smooth)


def _paid(scored: Scored) -> float:
    """Score, with pulses paid for."""
    return scored.score + paid(scored.fit.point.variant.pulses)


def _bare(fit: Fit) -> Fit:
    """Without its pulses, its effects fitted again."""
    return fit.problem.minimise(replace(fit.point, variant=replace(fit.point.variant, pulses=())))


def _without_pulses(best: Scored) -> Scored:
    """Without its pulses, if its effects do as well."""
    fit, pulses = best.fit, best.fit.point.variant.pulses
    if not pulses:
        return best
    without = _bare(fit)
    loss = without.cost - fit.cost
    return best if loss > paid(pulses) else replace(best, fit=without, score=best.score + loss)


@dataclass(frozen=True)
class _Trial:
    """Held-out recordings, in windows and in long rollouts."""

    windows: Problem
    rollouts: Problem
    known: list[tuple[Fit, Fit]] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, fit: Fit, test: Sequence[Recording], sigma: NDArray[np.float64]) -> "_Trial":
        simulator = fit.problem.simulator
        seen = min(int(np.isfinite(r.qpos).any(axis=1).sum()) for r in test if r.qpos is not None)
        horizon = max(1, min(HORIZON, seen // SAMPLES))
        short, long = (cut(test, simulator.step, n) for n in (SAMPLES, SAMPLES * horizon))
        return cls(Problem(simulator, short, sigma), Problem(simulator, long, sigma))

    def lengthened(self, training: Sequence[Recording]) -> Problem:
        """Training recordings in windows as long as the long rollouts."""
        samples = min(self.rollouts.windows.time.shape[1], *(len(np.asarray(r.t_state)) for r in training))
        problem = self.rollouts
        return replace(problem, windows=cut(training, problem.simulator.step, samples))

    @property
    def samples(self) -> int:
        """Of a long rollout."""
        return self.rollouts.windows.time.shape[1]

    @property
    def seconds(self) -> float:
        """Of a long rollout."""
        time = self.rollouts.windows.time
        return float(np.median(time[:, -1] - time[:, 0]))

    def short(self, fit: Fit) -> Fit:
        """On windows."""
        return replay(self.windows, fit)

    def long(self, fit: Fit) -> Fit:
        """On long rollouts, with the pulses of the windows: their times are found best there; once."""
        for asked, rolled in self.known:
            if asked is fit:
                return rolled
        pulses = self.short(fit).point.variant.pulses if fit.point.variant.pulses else ()
        self.known.append((fit, replay(self.rollouts, fit, 12, pulses)))
        return self.known[-1][1]
