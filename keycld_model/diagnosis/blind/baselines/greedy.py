"""Forward selection: the effect that gains most, then the one that gains most beside it, until none pays."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.blind.baselines.common import Setup, finding
from keycld_model.diagnosis.fit import Fit, knobs
from keycld_model.diagnosis.search import Hypothesis, hypotheses

LARGEST = 6


def greedy(training: Sequence[Recording], held_out: Sequence[Recording], model: mujoco.MjModel) -> dict[str, Any]:
    """The library and the linearisation of the diagnosis, one effect at a time, with the Bayesian criterion."""
    setup = Setup.of(training, held_out, model)
    best = setup.refitted
    while len(best.effects) < LARGEST and (effect := _next(best, model)) is not None:
        longer = best.problem.minimise(best.point.with_effects(*best.effects, effect))
        if _price(longer) >= _price(best):
            break
        best = longer
    findings = [_finding(effect) for effect in best.effects]
    return setup.report("mismatch" if findings else "no_mismatch", findings, best.point.variant, best.chi_square)


def _price(fit: Fit) -> float:
    """Schwarz (1978), in nats."""
    return fit.cost + 0.5 * np.log(fit.problem.samples) * len(knobs(fit.effects))


def _next(fit: Fit, model: mujoco.MjModel) -> Effect | None:
    """What gains most by the linearisation, its numbers paid for; None if nothing does."""
    used = {(e.id, e.where) for e in fit.effects}
    free = [h for h in hypotheses(model, ("external_pulse",)) if h.key not in used]
    probes = [(h, probe) for h in free for probe in h.probes()]
    linear, probed = fit.problem.linearise(fit.point, [(*fit.effects, probe) for _, probe in probes])
    weights = linear.outlier_weights()
    linear = linear.weighted(weights)
    columns = np.stack([linear.residual - weights * r for r in probed], axis=-1)
    rows = linear.project(np.concatenate([linear.shared, columns, linear.residual[..., None]], axis=-1))
    gram = np.einsum("wri,wrj->ij", rows, rows)
    n, p = len(fit.problem.spreads), linear.shared.shape[2]
    gram[np.arange(n), np.arange(n)] += fit.problem.spreads**-2
    left = gram[p:, p:] - gram[:p, p:].T @ np.linalg.pinv(gram[:p, :p], hermitian=True) @ gram[:p, p:]
    best, chosen = 0.0, None
    for worth, effect in _worths(free, left, 0.5 * np.log(fit.problem.samples)):
        if worth > best:
            best, chosen = worth, effect
    return chosen


def _worths(free: list[Hypothesis], left: np.ndarray, price: float) -> Iterator[tuple[float, Effect]]:
    """Nats of each hypothesis, and its effect; those whose signs physics forbids are left out."""
    column = 0
    for hypothesis in free:
        size = max(1, len(hypothesis.coefficients))
        mine = slice(column, column + size)
        column += size
        matrix, vector = left[mine, mine], left[mine, -1]
        amounts = np.linalg.lstsq(matrix + 1e-9 * np.trace(matrix) * np.eye(size), vector, rcond=None)[0]
        values = {}
        for p, amount in zip(hypothesis.coefficients, amounts, strict=False):
            values[p.name] = p.absent + float(amount) * p.scale
        if any(not p.low <= values[p.name] <= p.high for p in hypothesis.coefficients):
            continue
        effect = replace(hypothesis.effect, **values)
        yield 0.5 * float(vector @ amounts) - price * len(knobs([effect])), effect


def _finding(effect: Effect) -> dict[str, Any]:
    parameters = {p.name: {"value": getattr(effect, p.name), "unit": p.unit} for p in effect.parameters()}
    return finding(effect.id, effect.family, effect.kind, effect.where, parameters)
