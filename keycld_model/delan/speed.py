"""How fast a joint model answers."""

import time

from keycld_model.delan.model import JointModel
from keycld_model.delan.motions import Motions

CALLS, PASSES = 1000, 15
"""The fastest of some passes: whatever else a machine does makes others slower, and none faster."""


def inverse_dynamics_per_second(model: JointModel, motions: Motions) -> float:
    """Calls of `JointModel.inverse_dynamics` per second, one sample at a time, each waited for; the fastest pass."""
    q, v, a = (motions.all(name) for name in ("q", "v", "a"))
    model.inverse_dynamics(q[0], v[0], a[0])
    rates = []
    for _ in range(PASSES):
        started = time.perf_counter()
        for i in range(CALLS):
            k = i % len(q)
            model.inverse_dynamics(q[k], v[k], a[k])
        rates.append(CALLS / (time.perf_counter() - started))
    return max(rates)
