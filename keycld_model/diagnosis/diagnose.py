"""The whole diagnosis: refit, search, test on held-out recordings, report."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.errors import InputError
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.checks import check, check_apart
from keycld_model.diagnosis.evidence import evidence
from keycld_model.diagnosis.fit import Fit, Point, Problem, knobs
from keycld_model.diagnosis.noise import noise
from keycld_model.diagnosis.report import Estimate, Finding, FitErrors, Report, Unexplained, Verdict
from keycld_model.diagnosis.search import Scored, Search
from keycld_model.diagnosis.simulator import Simulator, Variant
from keycld_model.diagnosis.windows import cut

SAMPLES = 40
"""Per window."""
WINDOWS = 80
"""At most, for the search."""
HORIZON = 4
"""Windows that a long rollout is as long as."""
FASTEST = 0.009
"""Seconds between samples, at least; of faster recordings only some samples are used."""
CLEAR, DOUBTFUL = 10.0, 3.0
"""Nats that findings must gain, with their numbers paid for, to be certain, and to be mentioned."""
EXPLAINED = 1.3
"""Mean square of whitened residuals up to which only noise is left."""
EXCLUDED = ("external_pulse",)
"""Effects that need a search of their own, which does not exist yet."""


def diagnose(
    recordings: Sequence[Recording],
    model: mujoco.MjModel,
    held_out: Sequence[Recording] = (),
) -> Report:
    """Find physics that a simulator lacks.

    Args:
        recordings: joint positions and commands; a third of them is held out unless `held_out` is given.
        model: the simulator, of hinges and slides.
        held_out: recordings to test findings on, of other amplitudes and inputs.

    Returns:
        The report.

    Raises:
        InputError: if the recordings do not suit the model, or nothing can be learned from them.
    """
    check([*recordings, *held_out], model)
    check_apart(recordings, held_out)
    training, test = (recordings, held_out) if held_out else split(recordings)
    training, test = [thin(r) for r in training], [thin(r) for r in test]
    spacing = float(np.median(np.concatenate([np.diff(np.asarray(r.t_state)) for r in training])))
    fine, sigma = spacing / np.ceil(spacing / 0.0101), noise(training)
    simulators = [Simulator(model, fine), Simulator(model)]
    with progress("Diagnosing", total=4) as advance:
        fits = sorted((_refit(simulator, training, sigma) for simulator in simulators), key=lambda fit: fit.cost)
        advance(1, "searching")
        refitted, other = fits  # a simulation repeats its own integrator, nature has none
        search = Search(refitted.problem, EXCLUDED)
        best = search.run(refitted.point)
        if other.problem.minimise(other.point.with_effects(*best.fit.effects)).cost < best.fit.cost - 1:
            refitted, search = other, Search(other.problem, EXCLUDED)
            best = search.run(refitted.point)
        best = search.soften(best)
        problem = refitted.problem
        simulator, windows, step = problem.simulator, problem.windows, problem.simulator.step
        advance(1, "rivals")
        rivals = search.rivals(best)
        advance(1, "testing on held-out recordings")
        trial = Problem(simulator, cut(test, step, SAMPLES), sigma)
        tried, tried_best = (_try(trial, f) for f in (refitted, best.fit))
        long = Problem(simulator, cut(test, step, SAMPLES * _horizon(test)), sigma)
        gain = refitted.cost / search.temper - best.score
        nats = (_likelihood(tried_best) - _likelihood(tried)) / search.temper
        verdict: Verdict = "no_mismatch"
        if best.fit.effects and gain > DOUBTFUL:
            verdict = "mismatch" if gain > CLEAR and nats > 0 else "undetermined"
        chosen = best.fit if verdict != "no_mismatch" else refitted
        nominal = replace(refitted, point=Point(Variant(np.zeros_like(problem.spreads)), *windows.initial_states()))
        rollouts = [_try(long, f, 12) for f in (nominal, refitted, chosen)]
        errors = FitErrors(
            f"root mean square of rollouts over {SAMPLES * _horizon(test) * spacing:.2g} s with fitted initial states",
            "mrad or mm",
            *(round(1e3 * _rollout_error(f), 4) for f in rollouts),
        )
        advance(1)
    unexplained = _unexplained(tried, tried if verdict == "no_mismatch" else tried_best, model)
    findings = [] if verdict == "no_mismatch" else _findings(best, rivals, search)
    return Report(
        verdict=verdict,
        headline=_headline(verdict, findings, errors, unexplained),
        findings=findings,
        nuisance=_nuisance(chosen),
        unexplained=unexplained,
        fit=errors,
        held_out=[r.id for r in test],
        details={
            "gain_nats": round(float(gain), 2),
            "held_out_gain_nats": round(float(nats), 2),
            "chi_square": {"refitted": refitted.chi_square, "corrected": chosen.chi_square},
            "temper": search.temper,
            "noise": sigma.tolist(),
            "windows": len(windows),
            "step_s": step,
            "integrator": mujoco.mjtIntegrator(simulator.model.opt.integrator).name,
        },
        evidence=evidence(model, (refitted, chosen), (rollouts[1], rollouts[2]), (training, test)),
    )


def _refit(simulator: Simulator, recordings: Sequence[Recording], sigma: NDArray[np.float64]) -> Fit:
    """Nuisances alone."""
    windows = cut(recordings, simulator.step, SAMPLES)
    if len(windows) > WINDOWS:
        windows = windows.take(np.linspace(0, len(windows) - 1, WINDOWS).round().astype(int))
    problem = Problem(simulator, windows, sigma)
    return problem.minimise(problem.start(), iterations=15)


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings: every third in the order of their speed; of a single one, its last third."""
    if len(recordings) == 1:
        whole = recordings[0]
        t = np.asarray(whole.t_state)
        k = 2 * len(t) // 3
        if len(t) - k < SAMPLES:
            raise InputError(
                f"Recording {whole.id!r} has {len(t)} samples, too few to hold some out; record at least {3 * SAMPLES}."
            )
        return [_part(whole, slice(0, k), "")], [_part(whole, slice(k, None), " (last third)")]
    speed = [np.nanmean(np.abs(np.diff(np.asarray(r.qpos), axis=0))) for r in recordings]
    order = [recordings[i] for i in np.argsort(speed, kind="stable")]
    return [r for i, r in enumerate(order) if i % 3 != 1], order[1::3]


def thin(recording: Recording) -> Recording:
    """With samples no closer than `FASTEST`."""
    t = np.asarray(recording.t_state)
    every = max(1, round(FASTEST / float(np.median(np.diff(t)))))
    return _part(recording, slice(None, None, every), "") if every > 1 else recording


def _part(recording: Recording, piece: slice, suffix: str) -> Recording:
    qvel = recording.qvel
    return replace(
        recording,
        id=recording.id + suffix,
        t_state=np.asarray(recording.t_state)[piece],
        qpos=np.asarray(recording.qpos)[piece],
        qvel=None if qvel is None else qvel[piece],
    )


def _horizon(recordings: Sequence[Recording]) -> int:
    """Windows per long rollout."""
    return max(1, min(HORIZON, min(len(np.asarray(r.t_state)) for r in recordings) // SAMPLES))


def _try(problem: Problem, fit: Fit, iterations: int = 8) -> Fit:
    """The numbers of a fit on other recordings; only initial states are fitted."""
    start = Point(fit.point.variant, *problem.windows.initial_states())
    return problem.minimise(start, iterations, only_states=True)


def _likelihood(fit: Fit) -> float:
    """Nats, without the prior."""
    return 0.5 * float(np.sum((fit.point.variant.values / fit.problem.spreads) ** 2)) - fit.cost


def _residual(fit: Fit) -> NDArray[np.float64]:
    """Whitened, `[W, n, nv]`."""
    return fit.problem.residual(fit.point).reshape(fit.problem.windows.measured.shape)


def _rollout_error(fit: Fit) -> float:
    return float(np.sqrt(np.mean((_residual(fit) * fit.problem.noise) ** 2)))


def _findings(best: Scored, rivals: dict[tuple[str, str], list[Scored]], search: Search) -> list[Finding]:
    deviations = iter(best.fit.deviations() * np.sqrt(max(search.temper, best.fit.chi_square)))
    weights = {keys: np.exp(min(0.0, best.score - s.score)) for keys, s in search.found.items()}
    total = sum(weights.values())
    findings = []
    for effect in best.fit.effects:
        key = effect.id, effect.where
        others = {k for s in rivals.get(key, ()) for k in s.keys - best.keys}
        findings.append(
            Finding(
                effect=effect.id,
                family=effect.family,
                where={"kind": effect.kind, "name": effect.where},
                parameters=_estimates(effect, deviations),
                equation=effect.equation,
                confidence=round(float(sum(w for keys, w in weights.items() if key in keys) / total), 4),
                rivals=sorted({name if where == effect.where else f"{name} at {where}" for name, where in others}),
            )
        )
    return findings


def _estimates(effect: Effect, deviations: Iterator[float]) -> dict[str, Estimate]:
    out = {}
    for knob in knobs([effect]):
        value, deviation = getattr(effect, knob.parameter.name), 1.645 * next(deviations)
        low, high = max(value - deviation, knob.parameter.low), min(value + deviation, knob.parameter.high)
        out[knob.parameter.name] = Estimate(value, knob.parameter.unit, low, high)
    return out


def _nuisance(fit: Fit) -> dict[str, Estimate]:
    covariance = np.diag(np.linalg.pinv(fit.hessian))
    out = {}
    values = zip(fit.problem.simulator.nuisances, fit.point.variant.values, covariance, strict=False)
    for nuisance, value, variance in values:
        spread = 1.645 * np.sqrt(max(variance, 0.0))
        low, high, unit = value - spread, value + spread, "rad or m"
        if nuisance.kind != "zero":
            value, low, high, unit = np.exp(value), np.exp(low), np.exp(high), "of the simulator's"
        out[nuisance.name] = Estimate(float(value), unit, float(low), float(high))
    return out


def _unexplained(refitted: Fit, chosen: Fit, model: mujoco.MjModel) -> Unexplained:
    """From fits to held-out recordings."""
    before, after = (_mean_square(fit) for fit in (refitted, chosen))
    worst = int(after.argmax())
    significant = bool(after.max() > EXPLAINED)
    excess = max(float(before.max()) - 1, 1e-9)
    fraction = float(np.clip((after.max() - 1) / excess, 0, 1)) if significant else 0.0
    joint = model.joint(worst).name
    message = "What is left is noise."
    if significant:
        message = (
            f"The joint {joint!r} still deviates by {np.sqrt(after[worst]):.1f} times the noise of its sensor; no "
            "effect in the library explains it."
        )
    return Unexplained(significant, round(fraction, 4), joint if significant else None, message)


def _mean_square(fit: Fit) -> NDArray[np.float64]:
    """Of whitened residuals, per joint, `[nv]`, per degree of freedom."""
    return np.mean(_residual(fit) ** 2, axis=(0, 1)) / (1 - 2 / fit.problem.windows.measured.shape[1])


def _headline(verdict: Verdict, findings: list[Finding], errors: FitErrors, left: Unexplained) -> str:
    if verdict == "no_mismatch":
        return (
            "Nothing is missing: with masses, lengths and encoder zeros refitted, only noise is left."
            if (not left.significant)
            else f"No effect in the library explains what differs. {left.message}"
        )
    names = "; ".join(
        f"{f.effect.replace('_', ' ')} at {f.where['name']} ("
        + ", ".join(f"{n} = {e.value:.3g} ± {(e.high - e.low) / 2:.1g} {e.unit}" for n, e in f.parameters.items())
        + ")"
        for f in findings
    )
    verb = "lacks" if verdict == "mismatch" else "may lack"
    return (
        f"The simulator {verb} {names}; the held-out error goes from {errors.refitted:.3g} to {errors.corrected:.3g} "
        f"{errors.unit}."
    )
