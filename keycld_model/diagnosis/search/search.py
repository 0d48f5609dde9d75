"""Which effects explain what the refitted simulator cannot: sets of up to three, scored together, then refined."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from keycld_envs.effects import Effect
from keycld_envs.effects.transmission import TransmissionEffect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.search.criterion import Scored, dispersion, score_of
from keycld_model.diagnosis.search.effort import EFFORT
from keycld_model.diagnosis.search.hypotheses import hypotheses, recorded_range
from keycld_model.diagnosis.search.screening import promising
from keycld_model.diagnosis.search.transmissions import promising_transmissions, with_free_rotors
from keycld_model.diagnosis.simulation.variant import rotors

Keys = frozenset[tuple[str, str]]


def changed_effects(one: Scored, other: Scored) -> list[Effect]:
    """Effects that only one of two sets has."""
    return [e for s, t in ((one, other), (other, one)) for e in s.fit.effects if e.key not in t.keys]


class Search:
    """Finds sets of effects, and remembers all that were refined.

    Attributes:
        problem: what is to be explained.
        hypotheses: what may be missing.
        found: best fit of each set of effects and places.
        dispersion: nats of a fit that count as one, because even the best set leaves more than noise.
        restarts: transmissions are looked for from many starts.
        refined: called with every set that was refined, and with None before each that is glanced at.
    """

    def __init__(
        self,
        problem: Problem,
        exclude: Iterable[str] = (),
        most_effects: int | None = None,
        gained: float = 0.0,
        restarts: bool = True,
        refined: Callable[[Scored | None], None] = lambda scored: None,
        rival: float = np.inf,
    ) -> None:
        """A search for a number of effects at most.

        Args:
            problem: what is to be explained.
            exclude: ids of effects that are not looked for.
            most_effects: in a set; by default those of the criteria.
            gained: nats that were gained by what it starts with; they count for what is material.
            restarts: look for transmissions from many starts.
            refined: called with every set that was refined, and with None before each that is glanced at.
            rival: score of an explanation that is none of effects alone.
        """
        self.problem, self.gained, self.restarts, self.refined = problem, gained, restarts, refined
        self.most_effects = problem.criteria.sizes.effects if most_effects is None else most_effects
        self.hypotheses = hypotheses(problem.simulator.model, recorded_range(problem.windows), exclude)
        self.found: dict[Keys, Scored] = {}
        self.dispersion = 1.0
        self._rival, self._nothing = rival, np.inf
        self._replaced: set[tuple[Keys, tuple[str, str]]] = set()
        self._restarted: set[tuple[Keys, str]] = set()

    def run(self, start: Point, effects: Sequence[Effect] = ()) -> Scored:
        """The best set of effects, with some to start from; none if nothing is worth its parameters."""
        best = self.refine(start.with_effects())
        self._nothing = best.score + self.gained
        if effects:
            best = min(best, self.refine(start.with_effects(*effects)), key=score_of)
        for _ in range(EFFORT.rounds):
            better = self._simplified(self._pruned(min([best, *self._finalists(best)], key=score_of)))
            if self._nothing - better.score < EFFORT.far_behind * (self._nothing - self._rival):
                return better
            better = self._simplified(self._exchanged(better))  # what came in another's place may have a simpler form
            better = self._simplified(self._of_best_form(better))
            if not better.improves_on(best, self.least(better)):
                return better if better.score < best.score and len(better.keys) == len(best.keys) else best
            best = better
        return best

    @property
    def best(self) -> Scored:
        """The best set of all that were refined so far."""
        return min(self.found.values(), key=score_of)

    def with_dispersion(self, best: Scored) -> Scored:
        """The best set when gains are measured by what the best set leaves, not by the sensor's noise alone.

        Where no set of effects fits down to the noise, effects are found otherwise that only mend the shape of the
        misfit; see `dispersion`. Where only noise is left, this changes nothing.
        """
        self.dispersion = dispersion(best.fit)
        if self.dispersion == 1.0:
            return best
        self.found = {keys: Scored.of(s.fit, self.dispersion) for keys, s in self.found.items()}
        self._nothing = min((s.score for keys, s in self.found.items() if not keys), default=np.inf)
        return self._pruned(self.best)

    def least(self, scored: Scored) -> float:
        """Nats that one more effect must gain."""
        return max(self.problem.criteria.effect, self.least_of_form(scored))

    def least_of_form(self, scored: Scored) -> float:
        """Nats that further numbers of an effect's form must gain, since no form is exact."""
        criteria = self.problem.criteria
        share = criteria.effect_share_beside_pulses if self.gained else criteria.effect_share
        return share * max(0.0, self._nothing - scored.score)

    def refine(self, point: Point, thoroughly: bool = False) -> Scored:
        """A set of effects, fitted to its end if `thoroughly`, and remembered if it is better than before."""
        scored = Scored.of(self._minimised(point, thoroughly), self.dispersion)
        noise = self.problem.criteria.noise_variance
        if rotors(point.effects) and point.variant.window_offsets is None and scored.fit.chi_square > noise:
            free = self._minimised(with_free_rotors(self.problem, scored.fit.point), thoroughly)
            scored = min(scored, Scored.of(free, self.dispersion), key=score_of)
        if scored.keys not in self.found or scored.score < self.found[scored.keys].score:
            self.found[scored.keys] = scored
        self.refined(scored)
        return scored

    def _minimised(self, point: Point, thoroughly: bool) -> Fit:
        return minimise(self.problem, point, 40) if thoroughly else minimise(self.problem, point, share=EFFORT.rough)

    def exchange(self, best: Scored, effect: Effect) -> None:
        """Look for sets with another effect in one's place; once."""
        if (best.keys, effect.key) in self._replaced:
            return
        self._replaced.add((best.keys, effect.key))
        rest = [e for e in best.fit.effects if e is not effect]
        without = self.refine(best.fit.point.with_effects(*rest))
        self._finalists(without, largest=1, besides=effect)
        self._elsewhere(without, effect)
        for other in self._other_forms(effect):
            if other.key not in best.keys:
                self.refine(best.fit.point.with_effects(*rest, other))
        self._restart(best, rest, effect)

    def unite(self, best: Scored) -> None:
        """Look for sets with one effect in place of two at a joint.

        Dry friction beside a force is friction that differs by direction.
        """
        for effect, second in itertools.permutations(best.fit.effects, 2):
            if (effect.kind, effect.where) == (second.kind, second.where):
                rest = [e for e in best.fit.effects if e is not effect and e is not second]
                for other in self._other_forms(effect):
                    self.refine(best.fit.point.with_effects(*rest, other))

    def _other_forms(self, effect: Effect) -> Iterator[Effect]:
        """Effects that do nearly the same at its place, as large as it is."""
        return effect.confusable_with((h.effect for h in self.hypotheses), self.problem.simulator.model)

    def near_forms(self, best: Scored) -> list[Scored]:
        """Sets nearly as good as the best, with a confusable effect in one's place."""
        near = []
        for s in self._near(best):
            groups = {e.confusable and e.confusable.group for e in changed_effects(best, s)}
            if len(groups) == 1 and None not in groups:
                near.append(s)
        return near[: EFFORT.near_sets]

    def near(self, best: Scored) -> list[Scored]:
        """Sets nearly as good as the best, with another effect in one's place."""
        return self._near(best)[: EFFORT.near_sets]

    def _near(self, best: Scored) -> list[Scored]:
        """All of them, the best first."""
        found = [s for keys, s in self.found.items() if len(keys) == len(best.keys) and len(keys - best.keys) == 1]
        return sorted((s for s in found if s.score < best.score + EFFORT.near_nats), key=score_of)

    def _of_best_form(self, best: Scored) -> Scored:
        """Fitted to its end, with the form that explains most by then."""
        self.unite(best)
        sets = best, *self.near_forms(best)
        return min((self.refine(s.fit.point, thoroughly=True) for s in sets), key=score_of)

    def _exchanged(self, best: Scored) -> Scored:
        """With one effect in another's place as long as that is better."""
        while True:
            for effect in best.fit.effects:
                self.exchange(best, effect)
            better = min([best, *self._near(best)], key=score_of)
            if better is best:
                return best
            best = better

    def _restart(self, best: Scored, rest: Sequence[Effect], effect: Effect) -> None:
        """Look at transmissions in one's place from many starts; once."""
        place = frozenset(e.key for e in rest), effect.where
        if not isinstance(effect, TransmissionEffect) or not self.restarts or place in self._restarted:
            return
        self._restarted.add(place)
        sample = self._sample(best.fit, EFFORT.rotor_windows)
        for effects in promising_transmissions(sample, rest, effect, self.hypotheses):
            self.refine(best.fit.point.with_effects(*effects))

    def _simplified(self, best: Scored) -> Scored:
        """With fewer effects, or as many of fewer parameters, if any set found explains materially as much.

        What is likeliest among them may still have more than others have; so again, until there is none with fewer.
        """
        least, form, simplest, score = self.least(best), self.least_of_form(best), best, best.score
        while True:
            fewer = [s for s in self.found.values() if s.size < simplest.size and s.score < score + 10 * least]
            refined = [self.refine(s.fit.point) for s in sorted(fewer, key=score_of)[: EFFORT.finalists]]
            as_good = [s for s in refined if s.score < score + (least if len(s.keys) < len(best.keys) else form)]
            if not as_good:
                return simplest
            simplest = min(as_good, key=lambda s: (s.size, s.score))

    def _pruned(self, best: Scored) -> Scored:
        """Without effects that are not worth their parameters."""
        while True:
            doubtful = self.dispersion * (EFFORT.tried_nats + 10 * self.least(best))
            fewer = [self._without(best, e) for e in best.fit.effects if best.fit.worth(e) < doubtful]
            if not fewer or (least := min(fewer, key=score_of)).score > best.score + self.least(best):
                return best
            best = least

    def _without(self, best: Scored, effect: Effect) -> Scored:
        """Without one of its effects; another may have had wrong parameters because of it."""
        rest = [e for e in best.fit.effects if e is not effect]
        without = self.refine(best.fit.point.with_effects(*rest))
        for other in rest:
            self._restart(best, [e for e in rest if e is not other], other)
        return self.found[without.keys]

    def _elsewhere(self, scored: Scored, effect: Effect) -> None:
        """A set with an effect as one that it lacks, at the other place that promises most."""
        fit, used = self._sample(scored.fit), {effect.key, *(e.key for e in scored.fit.effects)}
        alike = [h for h in self.hypotheses if isinstance(h.effect, type(effect)) and h.key not in used]
        for effects in promising(fit, alike, {1: 1}):
            self.refine(scored.fit.point.with_effects(*effects))

    def _finalists(self, scored: Scored, largest: int = 3, besides: Effect | None = None) -> list[Scored]:
        """The most promising sets with one to three more effects, of all besides one."""
        fit, used = self._sample(scored.fit), {e.key for e in scored.fit.effects}
        used |= set() if besides is None else {besides.key}
        free = [h for h in self.hypotheses if h.key not in used]
        sizes = range(1, min(largest, self.most_effects - len(scored.keys)) + 1)
        sets = promising(fit, free, {size: EFFORT.sets[size - 1] for size in sizes})
        glances = [self._glanced(fit, effects) for effects in sets]
        glances.sort(key=score_of)
        best = {len(s.fit.effects): s for s in reversed(glances)}  # of each size
        chosen = {id(s): s for s in (*best.values(), *glances[: EFFORT.finalists])}
        return [self.refine(scored.fit.point.with_effects(*s.fit.effects)) for s in chosen.values()]

    def _glanced(self, fit: Fit, effects: Sequence[Effect]) -> Scored:
        """A set of effects after a few steps."""
        self.refined(None)
        return Scored.of(minimise(fit.problem, fit.point.with_effects(*effects), 3))

    def _sample(self, fit: Fit, fewest: int = EFFORT.sample_windows) -> Fit:
        """The fit on a share of the windows, of all degrees of misfit."""
        windows, enough = len(fit.problem.windows), EFFORT.sample_nats
        share = min(1.0, max(enough / max(fit.excess, enough), fewest / windows))
        if share == 1:
            return fit
        order = np.argsort(fit.problem.costs(fit.point))
        index = np.sort(order[np.linspace(0, windows - 1, round(share * windows)).round().astype(int)])
        part, point = fit.problem.take(index), fit.point.take(index)
        return replace(fit, problem=part, point=point, cost=part.cost(point))
