"""Which effects explain what the refitted simulator cannot: all sets of up to three, scored together."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from keycld_envs.effects import ActuatorDelay, Effect, SensorLatency
from keycld_envs.effects.base import TransmissionEffect
from keycld_model.diagnosis.estimation.fit import Fit, Point, Problem, knobs
from keycld_model.diagnosis.search.hypotheses import hypotheses, seen
from keycld_model.diagnosis.search.screening import promising
from keycld_model.diagnosis.simulation.simulator import rotors, unsettled

REFINED = {1: 4, 2: 3, 3: 2}
"""Sets of one, two and three effects that are refined a little after each linear scoring."""
GLANCE = 3
"""Gauss-Newton steps of that."""
FAVOURITES, CLOSER = 6, 10
"""Starts of rotors that are followed further, and how far."""
GLIMPSE = 15
"""Windows that choose among starts of rotors."""
ROUGH = 3e-4
"""Share of what is above noise that a step of a refinement must gain for another one."""
FINALISTS = 2
"""How many of them are then refined to the end, beside the best of each size."""
ENOUGH, FEWEST = 500.0, 30
"""Nats of misfit that suffice to choose among sets, and windows that do; where there is more, some are looked at."""
NOISE = 1.3
"""Variance that a fit may leave, over the sensor's, to count as noise."""
MATERIAL = 0.0005
"""Share of all that a set gains that each of its effects must gain. Named effects are idealised forms, of dry friction
near standstill above all; what gains less may only mend the form of another."""
BESIDE = 0.01
"""The same beside pushes from outside: these are idealised, and their times are found to some share of a step."""
LOOKED = 6.0
"""Nats that an effect must gain beyond the price of its numbers, for it was looked for among hundreds."""
DOUBTFUL = 100.0
"""Nats below which it is tried whether a fit needs an effect."""
LARGEST = 3
"""Effects at once; where more seem to be needed, the true one is not among them."""
DRY: dict[str, dict[str, float]] = {
    "coulomb_friction": {"c": 1.0},
    "stribeck_friction": {"c": 1.0},
    "asymmetric_friction": {"forward": 1.0, "backward": 1.0},
    "position_dependent_friction": {"c": 1.0},
    "hysteretic_friction": {"c": 1.0},
    "load_dependent_friction": {"mu": 0.1},
}
"""Dry friction, and its numbers for one of 1 N m or N; a bearing is thought to carry 10 N."""
LATE: dict[str, dict[str, float]] = {
    "actuator_delay": {"d": 1.0},
    "actuator_lag": {"lag": 1.0},
    "sensor_latency": {"d": 1.0},
}
"""What comes late, and its numbers for 1 s."""
LOOSENED = 6
"""Gauss-Newton steps of states before numbers are fitted to them."""
ALIKE, MOST_ALIKE = 50.0, 3
"""Nats behind the best within which sets that differ from it by kin may be better with shorter steps, and how many of
them are tried."""
ROUNDS = 3
"""Times that the search starts again from the best set so far."""


def penalty(fit: Fit) -> float:
    """Nats that a set of effects must gain to be worth its numbers (Schwarz, 1978).

    What effects remember at the start of a recording fits noise, too, and so do jumps of rotors, by half a nat each;
    two standard deviations more, for it is the best of many sets.
    """
    problem, jumps = fit.problem, fit.point.variant.jumps
    price = 0.5 * np.log(problem.samples) * len(knobs(fit.effects))
    if jumps is None:
        return price + 0.5 * len(unsettled(fit.effects)) * len(problem.windows.commands)
    return price + 0.5 * jumps.size + np.sqrt(2 * jumps.size)


def misfit(fit: Fit) -> float:
    """Variance of what a fit leaves over the sensor's, times the samples that it is correlated over; one for noise."""
    dof = max(1, fit.problem.samples - 2 * fit.point.q.size - len(fit.hessian))
    left = 2 * fit.cost / dof
    if left < NOISE:
        return 1.0
    residual = fit.problem.residual(fit.point).reshape(fit.problem.windows.measured.shape)
    together, n = 1.0, fit.problem.windows.measured.shape[1]
    for lag in range(1, n // 2):
        rho = float(np.sum(residual[:, lag:] * residual[:, :-lag]) / np.sum(residual**2)) * n / (n - lag)
        if rho < 0.05:
            break
        together += 2 * rho
    return max(1.0, left) * together


@dataclass(frozen=True)
class Scored:
    """A fit, and what it costs with its numbers paid for."""

    fit: Fit
    score: float

    @property
    def size(self) -> tuple[int, int]:
        """How many numbers the effects have, and how many effects they are."""
        return len(knobs(self.fit.effects)), len(self.keys)

    @property
    def keys(self) -> frozenset[tuple[str, str]]:
        """What and where."""
        return frozenset(e.key for e in self.fit.effects)


def kin(effect: Effect, others: Iterable[Effect], rails: bool) -> Iterator[Effect]:
    """Effects that do nearly the same: other kinds of dry friction at the same joint, or what comes as late.

    They differ near standstill, where responses are least linear, or to second order in the time, so that they are
    tried one by one. Friction of a load is costly to simulate, and an alias of others only on rails.
    """
    shares = DRY if effect.id in DRY else LATE
    if effect.id not in shares:
        return
    size = float(np.mean([getattr(effect, name) / share for name, share in shares[effect.id].items()]))
    tried = set()
    for other in others:
        near = other.where == effect.where or "sensor" in (other.kind, effect.kind)
        if near and other.key != effect.key and other.key not in tried:
            numbers = {name: share * size for name, share in shares.get(other.id, {}).items()}
            if numbers and size > 0 and (rails or other.id != "load_dependent_friction"):
                tried.add(other.key)
                yield replace(other, **numbers)


class Search:
    """Finds sets of effects, and remembers all that were refined.

    Attributes:
        found: best fit of each set of effects and places.
        temper: nats of a fit that count as one, because even the best set leaves more than noise.
        settled: rotors have been looked for from many starts already.
    """

    def __init__(
        self, problem: Problem, exclude: Iterable[str] = (), largest: int = LARGEST, gained: float = 0.0
    ) -> None:
        """A search for so many effects at most.

        `gained` nats were gained by what it starts with; they count for what is material.
        """
        self.largest, self.gained = largest, gained
        self.problem = problem
        self.hypotheses = hypotheses(problem.simulator.model, seen(problem.windows), exclude)
        self.found: dict[frozenset[tuple[str, str]], Scored] = {}
        self.temper, self.settled = 1.0, False
        self._nothing = np.inf
        self._replaced: set[tuple[frozenset[tuple[str, str]], tuple[str, str]]] = set()
        self._restarted: set[tuple[frozenset[tuple[str, str]], str]] = set()

    def run(self, start: Point, effects: Sequence[Effect] = ()) -> Scored:
        """The best set of effects, with some to start from; none if nothing is worth its numbers."""
        best = self._refine(start.with_effects())
        self._nothing = best.score + self.gained
        if effects:
            best = min(best, self._refine(start.with_effects(*effects)), key=_score)
        for _ in range(ROUNDS):
            better = self._simplified(self._pruned(min([best, *self._finalists(best)], key=_score)))
            better = self._refine(self._exchanged(better).fit.point, thoroughly=True)
            gained, least = best.score - better.score, self.least(better)
            if gained < (-least if better.size < best.size else least):
                break
            best = better
        return best

    def soften(self, best: Scored) -> Scored:
        """The best set when gains are measured by what the best set leaves, not by the sensor's noise alone.

        A quasi-likelihood (Burnham and Anderson, 2002, section 2.5): where no set of effects fits down to the noise,
        logarithms of likelihoods are divided by the variance that is left, times the samples over which it is
        correlated; otherwise effects are found that only mend the shape of the misfit. Where only noise is left, this
        changes nothing.
        """
        self.temper = misfit(best.fit)
        if self.temper == 1.0:
            return best
        self.found = {keys: self._scored(s.fit) for keys, s in self.found.items()}
        self._nothing = min((s.score for keys, s in self.found.items() if not keys), default=np.inf)
        return self._pruned(min(self.found.values(), key=_score))

    def _exchanged(self, best: Scored) -> Scored:
        """With one effect in another's place as long as that is better."""
        while True:
            for effect in best.fit.effects:
                self._replace(best, effect)
            swapped = [
                s for keys, s in self.found.items() if len(keys) == len(best.keys) and len(keys - best.keys) == 1
            ]
            better = min([best, *swapped], key=_score)
            if better is best:
                return best
            best = better

    def _replace(self, best: Scored, effect: Effect) -> None:
        """Look for sets with another effect in one's place; once."""
        if (best.keys, effect.key) not in self._replaced:
            self._replaced.add((best.keys, effect.key))
            rest = [e for e in best.fit.effects if e is not effect]
            self._finalists(self._refine(best.fit.point.with_effects(*rest)), largest=1)
            slides = self.problem.simulator.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
            for other in kin(effect, (h.effect for h in self.hypotheses), slides.any()):
                if other.key not in best.keys:
                    self._refine(best.fit.point.with_effects(*rest, other))
            self._restart(best, rest, effect)

    def _restart(self, best: Scored, rest: Sequence[Effect], effect: Effect) -> None:
        """Look at transmissions in one's place from many starts; once.

        How well they fit has many optima in their numbers.
        """
        place = frozenset(e.key for e in rest), effect.where
        if not isinstance(effect, TransmissionEffect) or self.settled or place in self._restarted:
            return
        self._restarted.add(place)
        fit, model = self._sample(best.fit, GLIMPSE), self.problem.simulator.model
        kinds = {type(h.effect) for h in self.hypotheses if isinstance(h.effect, TransmissionEffect)}
        inertia = float(model.dof_M0[effect.dof(model)])
        used, ordered = {e.key for e in rest}, sorted(kinds, key=lambda k: k.id)
        starts = [s for kind in ordered for s in kind.starts(effect.where, inertia) if s.key not in used]
        ways = (False, True) if fit.chi_square > NOISE else (False,)
        glances = [self._glance(fit, [*rest, start], loose) for start in starts for loose in ways]
        closer = [fit.problem.minimise(g.point, CLOSER) for g in sorted(glances, key=_cost)[:FAVOURITES]]
        for glance in sorted(closer, key=_cost)[:FINALISTS]:
            self._refine(best.fit.point.with_effects(*glance.effects))

    def _glance(self, fit: Fit, effects: Sequence[Effect], loose: bool) -> Fit:
        """A few steps with other effects; with rotors that may jump if `loose`."""
        point = fit.point.jumping(None).with_effects(*effects)
        return fit.problem.minimise(_loosened(fit.problem, point) if loose else point, GLANCE)

    def _simplified(self, best: Scored) -> Scored:
        """With fewer numbers, or as many of fewer effects, if any set found on the way explains materially as much."""
        least = self.least(best)
        fewer = [s for s in self.found.values() if s.size < best.size and s.score < best.score + 10 * least]
        refined = [self._refine(s.fit.point) for s in sorted(fewer, key=_score)[:FINALISTS]]
        return min([best, *(s for s in refined if s.score < best.score + least)], key=lambda s: (s.size, s.score))

    def least(self, scored: Scored) -> float:
        """Nats that one more effect must gain."""
        share = BESIDE if self.gained else MATERIAL
        return max(LOOKED, share * (self._nothing - scored.score))

    def _finalists(self, scored: Scored, largest: int = 3) -> list[Scored]:
        """The most promising sets with one to three more effects."""
        fit = self._sample(scored.fit)
        sets = self._promising(fit, min(largest, self.largest - len(scored.keys)))
        glances = []
        for effects in sets:
            glance = fit.problem.minimise(fit.point.with_effects(*effects), GLANCE)
            glances.append(Scored(glance, glance.cost + penalty(glance)))
        glances.sort(key=_score)
        sizes = {len(s.fit.effects): s for s in reversed(glances)}  # the best of each
        chosen = {id(s): s for s in (*sizes.values(), *glances[:FINALISTS])}
        return [self._refine(scored.fit.point.with_effects(*s.fit.effects)) for s in chosen.values()]

    def _sample(self, fit: Fit, fewest: int = FEWEST) -> Fit:
        """The fit on a share of the windows, of all degrees of misfit."""
        windows = len(fit.problem.windows)
        share = min(1.0, max(ENOUGH / max(fit.excess, ENOUGH), fewest / windows))
        if share == 1:
            return fit
        order = np.argsort(fit.problem.costs(fit.point))
        index = np.sort(order[np.linspace(0, windows - 1, round(share * windows)).round().astype(int)])
        part, point = fit.problem.take(index), fit.point.take(index)
        return replace(fit, problem=part, point=point, cost=part.cost(point))

    def rivals(self, best: Scored, within: float = 4.0) -> dict[tuple[str, str], list[Scored]]:
        """For each effect of the best set, sets with another in its place that explain as much, within some nats.

        So may one latency of all sensors in place of delays of all motors, and the reverse.
        """
        out = {}
        for effect in best.fit.effects:
            self._replace(best, effect)
            kept = best.keys - {effect.key}
            out[effect.key] = [
                s
                for keys, s in self.found.items()
                if kept < keys
                and len(keys) == len(best.keys)
                and keys != best.keys
                and s.score < best.score + within + _alias_price(best, s)
            ]
        late = [e for e in best.fit.effects if e.id in ("actuator_delay", "sensor_latency")]
        if others := self._otherwise_late(late):
            kept = [e for e in best.fit.effects if e not in late]
            scored = self._refine(best.fit.point.with_effects(*kept, *others))
            if scored.fit.cost < best.fit.cost + within * misfit(best.fit):
                for effect in late:
                    out[effect.key].append(scored)
        return out

    def _otherwise_late(self, late: Sequence[Effect]) -> list[Effect]:
        """A latency for delays of all motors, or these for that; one motor's delay is a rival anyway."""
        model, allowed = self.problem.simulator.model, {type(h.effect) for h in self.hypotheses}
        if model.nu < 2 or not {ActuatorDelay, SensorLatency} <= allowed:
            return []
        shifts = [e.d for e in late if isinstance(e, ActuatorDelay | SensorLatency)]
        if [type(e) for e in late] == [SensorLatency]:
            return [replace(e, d=shifts[0]) for e in ActuatorDelay.candidates(model)]
        if [type(e) for e in late] == [ActuatorDelay] * model.nu:
            return [replace(e, d=float(np.mean(shifts))) for e in SensorLatency.candidates(model)]
        return []

    def alike(self, best: Scored) -> list[Scored]:
        """Sets nearly as good as the best, with one effect's kin in its place: shorter steps may tell them apart."""
        near = []
        for s in self.found.values():
            one, other = ({e.id for e in x.fit.effects if e.key in x.keys - y.keys} for x, y in ((best, s), (s, best)))
            kindred = any(one | other <= set(kind) for kind in (DRY, LATE))
            exchanged = len(s.keys) == len(best.keys) and len(s.keys - best.keys) == 1
            if exchanged and kindred and s.score < best.score + ALIKE:
                near.append(s)
        return sorted(near, key=_score)[:MOST_ALIKE]

    def _refine(self, point: Point, thoroughly: bool = False) -> Scored:
        scored = self._scored(self._minimised(point, thoroughly))
        if rotors(point.variant.effects) and point.variant.jumps is None and scored.fit.chi_square > NOISE:
            loose = self._minimised(_loosened(self.problem, scored.fit.point), thoroughly)
            scored = min(scored, self._scored(loose), key=_score)
        if scored.keys not in self.found or scored.score < self.found[scored.keys].score:
            self.found[scored.keys] = scored
        return scored

    def _minimised(self, point: Point, thoroughly: bool) -> Fit:
        return self.problem.minimise(point, 40) if thoroughly else self.problem.minimise(point, share=ROUGH)

    def _scored(self, fit: Fit) -> Scored:
        return Scored(fit, fit.cost / self.temper + penalty(fit))

    def _pruned(self, best: Scored) -> Scored:
        """Without effects that are not worth their numbers."""
        while True:
            doubtful = [
                e for e in best.fit.effects if best.fit.worth(e) < self.temper * (DOUBTFUL + 10 * self.least(best))
            ]
            fewer = [self._without(best, effect) for effect in doubtful]
            if not fewer or (least := min(fewer, key=_score)).score > best.score + self.least(best):
                break
            best = least
        return best

    def _without(self, best: Scored, effect: Effect) -> Scored:
        """Without one of its effects; another may have had wrong numbers because of it."""
        rest = [e for e in best.fit.effects if e is not effect]
        without = self._refine(best.fit.point.with_effects(*rest))
        for other in rest:
            self._restart(best, [e for e in rest if e is not other], other)
        return self.found[without.keys]

    def _promising(self, fit: Fit, largest: int) -> Iterator[tuple[Effect, ...]]:
        """Sets that promise most at a fit's linearisation: its own effects, and up to some more."""
        used = {e.key for e in fit.effects}
        free = [h for h in self.hypotheses if h.key not in used]
        yield from promising(fit, free, {size: number for size, number in REFINED.items() if size <= largest})


def _loosened(problem: Problem, point: Point) -> Point:
    """With rotors that may jump at the starts of windows, and states fitted to that."""
    return problem.minimise(point.loosened(), LOOSENED, only_states=True).point


def _alias_price(best: Scored, other: Scored) -> float:
    """What more numbers cost a set that has the other as a limit: a spring, its zero far away, is a constant force."""
    exchanged = {e.id for s, t in ((best, other), (other, best)) for e in s.fit.effects if e.key not in t.keys}
    return max(0.0, penalty(other.fit) - penalty(best.fit)) if exchanged == {"spring", "constant_force"} else 0.0


def _cost(fit: Fit) -> float:
    return fit.cost


def _score(scored: Scored) -> float:
    return scored.score
