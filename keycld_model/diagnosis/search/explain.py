"""What explains the training recordings: effects, pushes, or a residual force; with steps that are short enough."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.linearisation import Linearisation
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.pulses import concentrated, contaminated, paid, price, with_best_pulses
from keycld_model.diagnosis.estimation.replay import replay
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.search.budget import Budget, OutOfTime
from keycld_model.diagnosis.search.criterion import Scored, above_noise, dispersion, penalty, score_of
from keycld_model.diagnosis.search.effort import EFFORT
from keycld_model.diagnosis.search.residual_fit import fit_residual_force, freedom
from keycld_model.diagnosis.search.search import Keys, Search
from keycld_model.diagnosis.simulation.simulator import Simulator

Refined = Callable[[Scored | None], None]


@dataclass(frozen=True)
class Explanation:
    """What training recordings say.

    Attributes:
        search: for effects.
        refitted: nuisances alone.
        best: with effects or pulses.
        residual: refitted, with a residual force; None where it was not needed.
        leads: nats by which all recordings prefer the best set to others, where held-out ones were asked.
    """

    search: Search
    refitted: Fit
    best: Scored
    residual: Fit | None
    leads: Mapping[Keys, float] = field(default_factory=dict)

    def lead(self, other: Scored) -> float:
        """Nats by which the best set is preferred to another; by training recordings, where no others were asked."""
        return self.leads.get(other.keys, other.score - self.best.score)

    @property
    def gain(self) -> float:
        """Nats of effects and pulses, with their parameters paid for."""
        return float(self.refitted.cost / self.search.dispersion - with_pulses_paid(self.best))

    @property
    def of_weak_effect(self) -> "Explanation | None":
        """With the likeliest single effect, where nothing was worth its parameters; None if none was refined."""
        singles = [scored for keys, scored in self.search.found.items() if len(keys) == 1]
        if not singles or self.best.keys or self.best.fit.point.variant.pulses:
            return None
        return replace(self, best=min(singles, key=score_of))

    @property
    def on_all_windows(self) -> Fit:
        """The best fit, with pulses also where was not searched."""
        fit = self.best.fit
        if not fit.point.variant.pulses:
            return fit
        windows = fit.problem.windows.recut()
        return replay(replace(fit.problem, windows=windows), fit) if len(windows) > len(fit.problem.windows) else fit


def refit(simulator: Simulator, windows: Windows) -> Fit:
    """Nuisances alone, on windows of recordings."""
    problem = problem_of(simulator, windows)
    return minimise(problem, problem.start(), iterations=15)


def problem_of(simulator: Simulator, windows: Windows) -> Problem:
    """Windows that are searched, of all, with the step of a simulator."""
    if windows.step != simulator.step:
        windows = windows.recut(step=simulator.step)
    return Problem(simulator, windows.take(windows.evenly(EFFORT.windows)))


def refit_accurately(simulator: Simulator, windows: Windows) -> Fit:
    """Nuisances alone, with steps so short that commands which jump within them do no harm."""
    refitted = refit(simulator, windows)
    for _ in range(2):
        if coarseness(refitted) < refitted.problem.criteria.doubtful:
            break
        simulator = simulator.with_step(simulator.step / 2)
        refitted = refit(simulator, windows)
    return refitted


def explain_either(accurate: Fit, own: Fit, refined: Refined, budget: Budget) -> Explanation:
    """With the integrator that is right: an accurate one for nature, the model's own for a simulation of itself.

    The own one is tried first where it leaves less than half of the misfit.

    Args:
        accurate: nuisances fitted with an accurate integrator.
        own: with the model's; the same fit if there is none.
        refined: called with every set that was refined, and with None before each that is glanced at; raises OutOfTime
            when there is no time for more.
        budget: of seconds.
    """
    if own is accurate:
        return explain(accurate, refined)
    better = accurate.excess > 0 and own.excess < 0.5 * accurate.excess  # else an accurate one leaves but noise
    first, second = (own, accurate) if better else (accurate, own)
    explained = explain(first, refined)
    best = explained.best.fit
    if best.point.variant.pulses or budget.leaves_out("the other integrator"):
        return explained
    other = min(second.cost, *(minimise(second.problem, point).cost for point in _with_effects_of(best, second)))
    return explain(second, refined) if other < best.cost - 1 else explained


def _with_effects_of(best: Fit, second: Fit) -> Iterator[Point]:
    """Where another integrator may begin: with all effects, and with those that are not of a sensor's clock.

    Euler's positions are half a step early, which with an accurate integrator is a sensor that is.
    """
    yield second.point.with_effects(*best.effects)
    own = [effect for effect in best.effects if effect.kind != "sensor"]
    if len(own) < len(best.effects):
        yield second.point.with_effects(*own)


def explain(refitted: Fit, refined: Refined = lambda scored: None, effects: Sequence[Effect] = ()) -> Explanation:
    """The best set of effects and pulses with one integrator, with some effects to start from.

    Where these need shorter steps, the search goes on with such. Pulses only where neither effects nor a residual force
    on the joints, which would come again in the same states, leave only noise, or where they do so but for few windows,
    or such a force is not worth as many numbers as it takes.
    Where pulses alone explain nearly all, transmissions are not looked for from many starts, and where effects explain
    far less, none is exchanged for another. When there is no time for more, the best set so far.
    """
    likely, criteria = with_best_pulses(refitted) if concentrated(refitted) else refitted, refitted.problem.criteria
    struck = bool(likely.point.variant.pulses) and likely.excess < criteria.idealised_share * refitted.excess
    rival = paid(likely) if struck else np.inf
    search = Search(refitted.problem, restarts=not effects and not struck, refined=refined, rival=rival)
    residual = None
    try:
        best = search.run(refitted.point, effects)
        coarse = not refitted.problem.simulator.own_integrator and not effects
        if coarse and best.fit.effects and (finer := _finer(refitted, search, best)):
            return explain(finer[0], refined, finer[1].effects)
        if above_noise(best.fit).max() > 0:
            residual = fit_residual_force(refitted)
        if perhaps_pushed(likely, best.fit, residual):
            search, best = _with_pulses(refitted, likely, search, best)
        return Explanation(search, refitted, search.with_dispersion(best), residual)
    except OutOfTime:
        return Explanation(search, refitted, search.with_dispersion(search.best), residual)


def _with_pulses(refitted: Fit, likely: Fit, search: Search, best: Scored) -> tuple[Search, Scored]:
    """A search beside pulses and what it found, if that is better.

    Args:
        refitted: nuisances alone.
        likely: the same with pulses.
        search: without pulses.
        best: what it found.
    """
    criteria = refitted.problem.criteria
    most = min(criteria.idealised_share * refitted.excess, criteria.unexplained_share * best.fit.excess)
    starts = [refitted, best.fit]
    for fit in starts:
        start = likely if fit is refitted else with_best_pulses(fit) if concentrated(fit) else fit
        if not start.point.variant.pulses:
            continue
        gained = refitted.cost - start.cost
        other = Search(refitted.problem, (), criteria.sizes.effects - 1, gained, refined=search.refined)
        found = _without_spurious_pulses(other.run(start.point, start.effects))
        pulses = found.fit.point.variant.pulses
        spurious = pulses and above_noise(found.fit).max() > 0 and found.fit.excess > most
        if spurious and fit is refitted and found.fit.effects:  # found beside effects, pulses may be others
            starts.append(_without_pulses(found.fit))
        if not spurious and with_pulses_paid(found) < with_pulses_paid(best) - search.least(best):
            return other, found
    return search, best


def perhaps_pushed(likely: Fit, best: Fit, residual: Fit | None) -> bool:
    """Whether pushes should be looked for.

    Args:
        likely: nuisances, and the pulses that windows show.
        best: effects without any.
        residual: nuisances, and a residual force; None where effects leave only noise.
    """
    if residual is None:
        return contaminated(best)
    if above_noise(residual).max() > 0:
        return True
    numbers = 0.5 * np.log(residual.problem.samples) * freedom(residual)
    return paid(likely) < residual.cost + numbers


def with_pulses_paid(scored: Scored) -> float:
    """Score, with pulses paid for."""
    return scored.score + price(scored.fit.point.variant.pulses, scored.fit.problem.criteria)


def _without_pulses(fit: Fit) -> Fit:
    """Without its pulses, its effects fitted again."""
    return minimise(fit.problem, fit.point.with_pulses())


def _without_spurious_pulses(best: Scored) -> Scored:
    """Without its pulses, if its effects do as well."""
    fit, pulses = best.fit, best.fit.point.variant.pulses
    if not pulses:
        return best
    without = _without_pulses(fit)
    loss = without.cost - fit.cost
    return best if loss > price(pulses, fit.problem.criteria) else replace(best, fit=without, score=best.score + loss)


def _finer(refitted: Fit, search: Search, best: Scored) -> tuple[Fit, Fit] | None:
    """Two fits with steps half as long, if the best explains more with them, or a set that is confusable with it does.

    Stiff springs, stops and rotors need them, and what differs by what happens within a step: a lag, and a delay.
    """
    factor, problem, others = dispersion(best.fit), best.fit.problem, search.near_forms(best)
    doubtful = problem.criteria.doubtful
    if not others and coarseness(best.fit) < doubtful * factor:
        return None
    problem = problem_of(problem.simulator.with_step(problem.simulator.step / 2), problem.windows)
    again = partial(minimise, problem)
    fine, *alternatives = (again(replay(problem, s.fit).point) for s in (best, *others))
    worth = [fit.cost / factor + penalty(fit, factor) for fit in (fine, *alternatives)]
    if min(worth) < worth[0] - doubtful:
        fine = alternatives[int(np.argmin(worth)) - 1]
    elif fine.cost > best.fit.cost - doubtful * factor:
        return None
    return again(replay(problem, refitted).point, iterations=15), fine


def coarseness(fit: Fit) -> float:
    """Nats by which steps half as long change what a fit predicts, beyond its initial states, from a few windows.

    Both by MuJoCo, if it can: nothing is compiled for this.
    """
    windows, simulator = fit.problem.windows, fit.problem.simulator
    some = np.unique(np.linspace(0, len(windows) - 1, 8).round().astype(int))
    part, point = fit.problem.take(some), fit.point.take(some)
    coarse, fine = (simulator.with_step(step, compiled=False) for step in (simulator.step, simulator.step / 2))
    residual, states = replace(part, simulator=coarse).linearise_states(point)
    finer = replace(part, simulator=fine, windows=part.windows.halved())
    change = Linearisation(finer.residual(point) - residual, states, residual[..., None])
    left = change.project(change.residual[..., None])
    return 0.5 * float(np.sum(left**2)) * len(windows) / len(some)
