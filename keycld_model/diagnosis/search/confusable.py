"""Effects that do nearly the same, and are tried in each other's place."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from keycld_envs.effects import Effect

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


def confusable(effect: Effect, others: Iterable[Effect], rails: bool) -> Iterator[Effect]:
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
