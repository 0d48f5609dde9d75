"""Sets of effects that the data do not exclude in place of the best."""

from collections.abc import Iterator

import numpy as np

from keycld_envs.effects import Effect
from keycld_model.diagnosis.search.criterion import Scored, dispersion, penalty
from keycld_model.diagnosis.search.search import Search, changed_effects
from keycld_model.diagnosis.simulation.places import places_of


def rivals_of(search: Search, best: Scored, effect: Effect) -> list[Scored]:
    """Sets with another effect in one's place that explain as much, within some nats."""
    search.exchange(best, effect)
    kept = best.keys - {effect.key}
    return [
        s
        for keys, s in search.found.items()
        if kept < keys
        and len(keys) == len(best.keys)
        and keys != best.keys
        and s.score < best.score + search.problem.criteria.rival + _alias_price(best, s)
    ]


def everywhere_rivals(search: Search, best: Scored) -> dict[tuple[str, str], Scored]:
    """For effects of the best set, a set that explains as much with one effect everywhere, or all.

    So may one latency of all sensors come for delays of all motors.
    """
    out = {}
    for now, instead in _everywhere(search, best):
        kept = [e for e in best.fit.effects if e not in now]
        scored = search.refine(best.fit.point.with_effects(*kept, *instead))
        if scored.fit.cost < best.fit.cost + search.problem.criteria.rival * dispersion(best.fit):
            out |= {effect.key: scored for effect in now}
    return out


def _everywhere(search: Search, best: Scored) -> Iterator[tuple[list[Effect], list[Effect]]]:
    """Effects of the best set, and others that do nearly the same: one for all places of another, or the reverse.

    At a single place they are confusable anyway. An effect that would be outside its bounds is no rival.
    """
    model, kinds = search.problem.simulator.model, list(dict.fromkeys(type(h.effect) for h in search.hypotheses))
    for one, many in ((one, many) for one in kinds for many in kinds if one.same_everywhere == many.id):
        now = [e for e in best.fit.effects if isinstance(e, one | many)]
        places, size = places_of(many, model), float(np.mean([e.size for e in now])) if now else 0.0
        if len(places) < 2 or size <= 0:
            continue
        if [type(e) for e in now] == [one]:
            yield now, [e.of_size(size) for e in places]
        elif [type(e) for e in now] == [many] * len(places):
            yield now, [e.of_size(size) for e in places_of(one, model)]


def _alias_price(best: Scored, other: Scored) -> float:
    """What more parameters cost a set that has the other as a limit: a spring, its zero far away, is constant."""
    exchanged = changed_effects(best, other)
    limits = any({e.id for e in exchanged} == {e.id, e.limiting_case} for e in exchanged)
    return max(0.0, penalty(other.fit) - penalty(best.fit)) if limits else 0.0
