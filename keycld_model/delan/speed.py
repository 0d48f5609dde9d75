"""How fast a joint model answers."""

import time

import numpy as np

from keycld_model.delan.model import JointModel
from keycld_model.delan.motions import Motions

CALLS, PASSES = 2000, 5


def inverse_dynamics_per_second(model: JointModel, motions: Motions) -> float:
    """Calls of `JointModel.inverse_dynamics` per second, one sample at a time, each waited for; the median of passes."""
    q, v, a = (motions.all(name) for name in ("q", "v", "a"))
    model.inverse_dynamics(q[0], v[0], a[0])
    rates = []
    for _ in range(PASSES):
        started = time.perf_counter()
        for i in range(CALLS):
            k = i % len(q)
            model.inverse_dynamics(q[k], v[k], a[k])
        rates.append(CALLS / (time.perf_counter() - started))
    return float(np.median(rates))
