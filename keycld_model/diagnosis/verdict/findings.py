"""What fits mean: findings with intervals, refitted nuisances, and what stays unexplained."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from keycld_envs.effects import Effect, ExternalPulse, Parameter, effect_class
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.pulses import joined
from keycld_model.diagnosis.search.criterion import above_noise, left_of_noise
from keycld_model.diagnosis.search.explain import Explanation
from keycld_model.diagnosis.verdict.region import shape_of
from keycld_model.diagnosis.verdict.report import Estimate, Finding, Unexplained
from keycld_model.diagnosis.verdict.rivals import Rivals
from keycld_model.rigid_body.residual_force import ResidualForce

RIGHT = {"explained": 0.92, "left": 0.19, "beside": 0.28}
"""What a set's weight is multiplied by, so that confidence is on average the share of findings that are right.

Counted by Laplace's rule on 400 sealed cases (docs/notebook/2026-11-23-sealed-cases.md): where named effects leave only
noise, where they leave more, and beside pushes or an unknown force. What is left was then told by windows alone, not by
long rollouts.
"""
ALONG = {
    "N m": "N",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "N m/rad": "N/m",
    "kg m^2": "kg",
    "rad": "m",
    "rad/s": "m/s",
}
"""Units of a slide, for those of a hinge."""


def findings_of(explained: Explanation, rivals: Rivals) -> list[Finding]:
    """One per effect of the best set, with 90 % intervals, and what the data do not exclude in its place."""
    best, search = explained.best, explained.search
    deviations = iter(best.fit.deviations() * np.sqrt(max(search.dispersion, best.fit.chi_square)))
    weights = {keys: np.exp(-max(0.0, explained.lead(s))) for keys, s in search.found.items()}
    total, model = sum(weights.values()), best.fit.problem.simulator.model
    out = []
    for effect in best.fit.effects:
        others = rivals.others(effect) | set(effect.indistinguishable(model))
        parameters = estimates(effect, [1.645 * next(deviations) for _ in effect.parameters()], model)
        confidence = float(sum(w for keys, w in weights.items() if effect.key in keys) / total)
        out.append(Finding.of(effect, parameters, confidence, sorted(others), region=_region(best.fit, effect)))
    return out


def _region(fit: Fit, effect: Effect) -> dict[str, tuple[float, float]] | None:
    shape = shape_of(fit, effect)
    return None if shape is None else shape.region(fit.problem.criteria)


def estimates(effect: Effect, halves: Iterable[float], model: mujoco.MjModel) -> dict[str, Estimate]:
    """Parameters of an effect by name, with intervals of these half widths."""
    pairs = zip(effect.parameters(), halves, strict=True)
    return {parameter.name: _estimate(effect, parameter, float(half), model) for parameter, half in pairs}


def _estimate(effect: Effect, parameter: Parameter, half: float, model: mujoco.MjModel) -> Estimate:
    """Its interval ends at the bounds of the parameter, if its value is within them."""
    value = float(getattr(effect, parameter.name))
    low, high = value - half, value + half
    if parameter.low <= value <= parameter.high:
        low, high = max(low, parameter.low), min(high, parameter.high)
    unit = parameter.unit
    if _slides(effect, model) and not parameter.temporal:
        unit = ALONG.get(unit, unit)
    return Estimate(value, unit, low, high)


def _slides(effect: Effect, model: mujoco.MjModel) -> bool:
    """The effect acts on a joint that slides."""
    if effect.kind == "joint":
        joint = model.joint(effect.where).id
    elif effect.kind == "actuator" and model.actuator(effect.where).trntype[0] == mujoco.mjtTrn.mjTRN_JOINT:
        joint = int(model.actuator(effect.where).trnid[0])
    else:
        return False
    return bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)


def nuisance_of(fit: Fit) -> dict[str, Estimate]:
    """Refitted masses, lengths and zeros with 90 % intervals."""
    out = {}
    values = zip(fit.problem.nuisances, fit.point.variant.values, np.diag(fit.covariance), strict=False)
    for nuisance, value, variance in values:
        spread = 1.645 * np.sqrt(max(variance, 0.0))
        low, high = value - spread, value + spread
        if nuisance.factor:
            value, low, high = np.exp(value), np.exp(low), np.exp(high)
        out[nuisance.name] = Estimate(float(value), nuisance.unit, float(low), float(high))
    return out


def far_off(fit: Fit) -> list[str]:
    """Refitted masses, lengths and zeros that are off by more than is expected of any mechanism, in words."""
    far, out = fit.problem.criteria.significant, []
    for nuisance, value in zip(fit.problem.nuisances, fit.point.variant.values, strict=False):
        if nuisance.factor and abs(value) > far * nuisance.spread:
            out.append(f"the {nuisance.name} is {np.exp(value):.3g} times the simulator's")
        elif nuisance.kind == "zero" and abs(value) > far * nuisance.spread:
            out.append(f"the {nuisance.name} is off by {value:.3g} {nuisance.unit}")
    return out


def unexplained_of(*tested: tuple[Fit, Fit]) -> Unexplained:
    """What fits to held-out recordings leave, where they leave most.

    Args:
        tested: pairs of fits to the same windows, with nuisances alone, and with what was found.
    """
    refitted, chosen = max(tested, key=lambda pair: float(above_noise(pair[1]).max()))
    before, after = (left_of_noise(fit) for fit in (refitted, chosen))
    excess = above_noise(chosen)
    worst = int(excess.argmax())
    more = bool(excess[worst] > 0)
    fraction = float(np.clip((after[worst] - 1) / max(float(before[worst]) - 1, 1e-9), 0, 1)) if more else 0.0
    joint = chosen.problem.windows.observation.names[worst]
    message = "What is left is noise."
    if more:
        message = (
            f"The joint {joint!r} still deviates by {np.sqrt(after[worst]):.1f} times the noise of its sensor; no "
            "effect in the library explains it."
        )
    return Unexplained(more, round(fraction, 4), joint if more else None, message)


def pulses_of(fit: Fit) -> list[Finding]:
    """One finding per joint that is pushed."""
    model, step, ids = fit.problem.simulator.model, fit.problem.simulator.step, fit.problem.windows.ids
    pulses = joined(fit.point.variant.pulses, 3 * step)
    pushed = [Pushed(p.dof, ids[p.recording], (p.start, p.start + p.duration), p.force) for p in pulses]
    return findings_of_pushes(pushed, model, confidence=1.0)


class Pushed(NamedTuple):
    """A push at a degree of freedom.

    Attributes:
        dof: its index.
        recording: id of it.
        span: begin and end, s.
        force: N m or N.
    """

    dof: int
    recording: str
    span: tuple[float, float]
    force: float


def findings_of_pushes(pushes: Sequence[Pushed], model: mujoco.MjModel, confidence: float) -> list[Finding]:
    """One finding per joint that is pushed."""
    out = []
    for dof in sorted({p.dof for p in pushes}):
        own = [p for p in pushes if p.dof == dof]
        when: dict[str, list[tuple[float, float]]] = {}
        for p in own:
            when.setdefault(p.recording, []).append(p.span)
        sizes = np.array([abs(p.force) for p in own])
        joint = model.joint(int(model.dof_jntid[dof]))
        unit = "N m" if joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE else "N"
        out.append(
            Finding(
                effect=ExternalPulse.id,
                family=ExternalPulse.family,
                where={"kind": "joint", "name": joint.name},
                parameters={"f": Estimate(float(np.median(sizes)), unit, float(sizes.min()), float(sizes.max()))},
                equation=ExternalPulse.equation,
                confidence=confidence,
                rivals=[],
                when=[span for spans in when.values() for span in spans] if len(when) == 1 else None,
                when_by_recording=when,
            )
        )
    return out


def residual_force_finding(fit: Fit, share: float) -> Finding:
    """The finding of a residual force, which gained a share of all that was gained on held-out recordings."""
    effect = fit.effects[-1]
    return Finding.of(effect, {}, share, region=_region(fit, effect))


def may_be_absent(finding: Finding) -> bool:
    """Whether the intervals of all coefficients hold what is none of the effect; of effects of the library."""
    effect = effect_class(finding.effect, finding.where["kind"])
    coefficients = [] if effect is None else [p for p in effect.parameters() if not p.grid]
    intervals = [(p.absent, finding.parameters[p.name]) for p in coefficients if p.name in finding.parameters]
    return bool(intervals) and all(found.low <= absent <= found.high for absent, found in intervals)


def calibrated(findings: Sequence[Finding], left: Unexplained) -> list[Finding]:
    """With confidence that counts how often findings of such reports are right; an unknown force keeps its own."""
    names, unknown = {f.effect for f in findings}, ResidualForce.id
    beside = len(names) > 1 and not names.isdisjoint({unknown, ExternalPulse.id})
    right = RIGHT["beside" if beside else "left" if left.significant else "explained"]
    return [f if f.effect == unknown else replace(f, confidence=round(right * f.confidence, 4)) for f in findings]
