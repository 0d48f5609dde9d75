"""Sets of effects that the data do not exclude in place of the best."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from keycld_envs.effects import ActuatorDelay, Effect, SensorLatency
from keycld_model.diagnosis.search.confusable import DRY, LATE
from keycld_model.diagnosis.search.criterion import Scored, dispersion, penalty, score_of
from keycld_model.diagnosis.search.effort import EFFORT
from keycld_model.diagnosis.search.search import Search


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


def late_rivals(search: Search, best: Scored) -> dict[tuple[str, str], Scored]:
    """A set with one latency of all sensors in place of delays of all motors, or the reverse, for each of these."""
    late = [e for e in best.fit.effects if e.id in ("actuator_delay", "sensor_latency")]
    others = _otherwise_late(search, late)
    if not others:
        return {}
    kept = [e for e in best.fit.effects if e not in late]
    scored = search.refine(best.fit.point.with_effects(*kept, *others))
    excluded = scored.fit.cost >= best.fit.cost + search.problem.criteria.rival * dispersion(best.fit)
    return {} if excluded else {effect.key: scored for effect in late}


def confusable_sets(search: Search, best: Scored) -> list[Scored]:
    """Sets nearly as good as the best that differ by confusable effects: shorter steps may tell them apart."""
    near = []
    for s in search.found.values():
        one, other = ({e.id for e in x.fit.effects if e.key in x.keys - y.keys} for x, y in ((best, s), (s, best)))
        alike = any(one | other <= set(kind) for kind in (DRY, LATE))
        exchanged = len(s.keys) == len(best.keys) and len(s.keys - best.keys) == 1
        if exchanged and alike and s.score < best.score + 50.0:
            near.append(s)
    return sorted(near, key=score_of)[: EFFORT.finer_sets]


def _otherwise_late(search: Search, late: Sequence[Effect]) -> list[Effect]:
    """A latency for delays of all motors, or these for that; one motor's delay is a rival anyway."""
    model, allowed = search.problem.simulator.model, {type(h.effect) for h in search.hypotheses}
    if model.nu < 2 or not {ActuatorDelay, SensorLatency} <= allowed:
        return []
    shifts = [e.d for e in late if isinstance(e, ActuatorDelay | SensorLatency)]
    if [type(e) for e in late] == [SensorLatency]:
        return [replace(e, d=shifts[0]) for e in ActuatorDelay.candidates(model)]
    if [type(e) for e in late] == [ActuatorDelay] * model.nu:
        return [replace(e, d=float(np.mean(shifts))) for e in SensorLatency.candidates(model)]
    return []


def _alias_price(best: Scored, other: Scored) -> float:
    """What more numbers cost a set that has the other as a limit: a spring, its zero far away, is a constant force."""
    exchanged = {e.id for s, t in ((best, other), (other, best)) for e in s.fit.effects if e.key not in t.keys}
    return max(0.0, penalty(other.fit) - penalty(best.fit)) if exchanged == {"spring", "constant_force"} else 0.0
