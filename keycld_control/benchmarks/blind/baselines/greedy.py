"""Forward selection: the effect that gains most, then the one that gains most beside it, until none pays."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.baselines.common import Setup, finding
from keycld_control.benchmarks.refitting import Fit, minimise
from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.search.hypotheses import hypotheses, recorded_range
from keycld_model.diagnosis.search.screening import promising

LARGEST = 6
"""Greatest number of effects."""


def greedy(training: Sequence[Recording], held_out: Sequence[Recording], model: mujoco.MjModel) -> dict[str, Any]:
    """The library and the linearisation of the diagnosis, one effect at a time, with the Bayesian criterion."""
    setup = Setup.of(training, held_out, model)
    best = setup.refitted
    while len(best.effects) < LARGEST and (effect := _next(best, model)) is not None:
        longer = minimise(best.problem, best.point.with_effects(*best.effects, effect))
        if _criterion(longer) >= _criterion(best):
            break
        best = longer
    findings = [_finding(effect) for effect in best.effects]
    return setup.report("mismatch" if findings else "no_mismatch", findings, best.point.variant, best.chi_square)


def _criterion(fit: Fit) -> float:
    """The Bayesian information criterion (Schwarz, 1978), in nats."""
    return fit.cost + 0.5 * np.log(fit.problem.samples) * sum(len(effect.parameters()) for effect in fit.effects)


def _next(fit: Fit, model: mujoco.MjModel) -> Effect | None:
    """What gains most by the linearisation, its numbers paid for; None if nothing does."""
    used = {e.key for e in fit.effects}
    free = [h for h in hypotheses(model, recorded_range(fit.problem.windows)) if h.key not in used]
    best = next(promising(fit, free, {1: 1}), None)
    return None if best is None else best[-1]


def _finding(effect: Effect) -> dict[str, Any]:
    parameters = {p.name: {"value": getattr(effect, p.name), "unit": p.unit} for p in effect.parameters()}
    return finding(effect.id, effect.family, effect.kind, effect.where, parameters)
