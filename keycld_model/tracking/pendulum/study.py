"""Period and dissipation of a free pendulum, judged by the part of the video that no fit has seen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipk
from scipy.stats import f

from keycld_envs.effects import phrase
from keycld_envs.progress import Advance
from keycld_model.tracking.pendulum.fit import Fit, fit_motion, thinned
from keycld_model.tracking.pendulum.motion import COMMON, TERMS, Motion

Array = NDArray[np.float64]
SPLITS = (0.5, 0.6, 0.7)
"""Shares of the video that are fitted; the rest is predicted."""
CANDIDATES = tuple(terms for n in range(3) for terms in combinations(TERMS, n))
FEWEST_SWINGS = 6
"""Half swings below which nothing is said about damping."""
PREDICTED = 0.1
"""Share of the motion's root mean square that predictions may be off: with more, it is not that of a pendulum, or not
at these times."""
HELD = 0.1
"""Share of a period; a pendulum that rests aside for so much longer than a turning point lasts is held."""
DRAWS = 400
PROBABILITY = 0.95
"""Of the F test by which a rival's held-out error excludes it."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One kind of dissipation.

    Attributes:
        terms: the effects.
        held_out: rad, root mean square error of predictions of what was not fitted, over all splits.
        fitted: rad, root mean square residual of the largest fitted share.
        excluded: it predicts worse than the best, by more than chance.
        fit: to the whole video.
    """

    terms: tuple[str, ...]
    held_out: float
    fitted: float
    excluded: bool
    fit: Fit


@dataclass(frozen=True, eq=False)
class Study:
    """What a free swing tells.

    Attributes:
        period: s, of swings so small that the amplitude does not matter, with a 90 % interval.
        swings: [n, 3] of the half swings: time of the middle, s, amplitude, rad, and twice their duration, s.
        rest: rad, angle of rest against the picture's downward direction.
        candidates: all dissipations, the best prediction first.
        named: effects that are named; None if the video cannot tell.
        words: the verdict as one sentence.
        parameters: of the best candidate: value, low, high and unit.
        split: s, from when on the drawn prediction was not fitted.
        prediction: [T] rad, by the best candidate from the first `SPLITS[1]` of the free swing, NaN before that.
        low, high: [T] rad, its 90 % interval.
    """

    period: tuple[float, float, float]
    swings: Array
    rest: float
    candidates: tuple[Candidate, ...]
    named: tuple[str, ...] | None
    words: str
    parameters: dict[str, tuple[float, float, float, str]]
    split: float
    prediction: Array
    low: Array
    high: Array


def study_pendulum(times: Array, angles: Array, seed: int, advance: Advance) -> Study | None:
    """Fit and compare all dissipations.

    Args:
        times: [T], s.
        angles: [T], rad from the picture's downward direction; NaN where missing.
        seed: of draws.
        advance: a progress bar, one step per candidate.

    Returns:
        None if the motion is no swing about an angle of rest, or no dissipation predicts it.
    """
    clock, q = thinned(times, angles)
    swings = half_swings(clock, q)
    if len(swings):
        free = released(clock, q, float(np.median(swings[:, 2])))
        clock, q = clock[free:], q[free:]
        swings = half_swings(clock, q)
    if len(swings) < FEWEST_SWINGS or np.ptp(q) > 1.8 * math.pi:
        return None
    rng = np.random.default_rng(seed)
    whole, errors, fitted = {}, {}, {}
    for terms in CANDIDATES:
        start = _start(clock, q, swings, terms)
        missed = []
        for share in SPLITS:
            end = round(share * len(clock))
            fit = fit_motion(Motion(terms), clock[:end], q[:end], start)
            missed.append(fit.angles(clock[end:]) - q[end:])
            fitted[terms] = fit.rms
        errors[terms] = missed
        whole[terms] = fit_motion(Motion(terms), clock, q, start)
        advance()
    held_out = {terms: _rms(errors[terms]) for terms in CANDIDATES}
    order = sorted(CANDIDATES, key=lambda terms: held_out[terms])
    if held_out[order[0]] > PREDICTED * float(np.std(q)):
        return None
    bound = _chance(swings, clock) * held_out[order[0]] ** 2
    candidates = tuple(
        Candidate(terms, held_out[terms], fitted[terms], held_out[terms] ** 2 > bound, whole[terms]) for terms in order
    )
    named, words = verdict(candidates)
    best = next((c for c in candidates if named is not None and set(c.terms) == set(named)), candidates[0])
    end = round(SPLITS[1] * len(clock))
    early = fit_motion(Motion(best.terms), clock[:end], q[:end], _start(clock, q, swings, best.terms))
    band, after = np.full((2, len(times)), np.nan), times >= early.origin
    band[:, after] = np.nanquantile(early.draws(times[after], DRAWS, rng), (0.05, 0.95), axis=0)
    parameters = _parameters(best.fit)
    return Study(
        _period(best.fit), swings, float(best.fit.parameters[1]), candidates, named, words, parameters,
        float(clock[end]), early.angles(times), *band,
    )  # fmt: skip


def verdict(candidates: Sequence[Candidate]) -> tuple[tuple[str, ...] | None, str]:
    """The dissipation that can be named, and the sentence that says so.

    A set of effects is named if no other set that is as small, or smaller, predicts as well.

    Args:
        candidates: the best prediction first.
    """
    left = [c for c in candidates if not c.excluded]
    fewest = min(len(c.terms) for c in left)
    simplest = [c for c in left if len(c.terms) == fewest]
    if len(simplest) == 1:
        name = _named(simplest[0].terms)
        larger = [c for c in left if len(c.terms) > fewest]
        beside = (
            f"; {' and '.join(_named(c.terms) for c in larger)} predict as well, with one effect more" if larger else ""
        )
        return simplest[0].terms, f"The dissipation is {name}{beside}."
    choices = ", ".join(_named(c.terms) for c in simplest)
    return None, f"The dissipation cannot be determined: {choices} predict this video equally well."


def half_swings(times: Array, angles: Array) -> Array:
    """Middle, amplitude and doubled duration of each half swing, from crossings of the angle of rest.

    Args:
        times: [T], s.
        angles: [T], rad.

    Returns:
        [n, 3]: s, rad, s.
    """
    rest = _rest(angles)
    away = angles - rest
    size = float(np.quantile(np.abs(away), 0.9))
    crossings: list[float] = []
    for i in range(1, len(away)):
        if away[i - 1] < 0 <= away[i] or away[i - 1] >= 0 > away[i]:
            crossings.append(times[i - 1] - away[i - 1] * (times[i] - times[i - 1]) / (away[i] - away[i - 1]))
    rows = []
    for first, last in pairwise(crossings):
        inside = (times > first) & (times < last)
        if inside.sum() >= 3:
            top = float(np.abs(away[inside]).max())
            if top > 0.02 * size:
                rows.append([(first + last) / 2, top, 2 * (last - first)])
    return np.array(rows).reshape(-1, 3)


def released(times: Array, angles: Array, period: float) -> int:
    """Index of the first angle of a free swing: a pendulum may be held aside before, and is then let go.

    A free one that crosses its middle was at most there a quarter of a period before, and nearer to it before that.

    Args:
        times: [T], s.
        angles: [T], rad.
        period: s, of the swing.
    """
    away = angles - _rest(angles)
    crossed = np.flatnonzero(away * away[0] < 0)
    if not len(crossed):
        return 0
    first = times[crossed[0]]
    before = np.abs(away[times < first - (0.25 + HELD) * period])
    turning = np.abs(away[: crossed[0]]).max()
    if not len(before) or np.median(before) < math.cos(2 * math.pi * HELD) ** 0.5 * turning:
        return 0
    return int(np.searchsorted(times, first - 0.2 * period))


def _rest(angles: Array) -> float:
    """Angle about which the swing is even: the mean of the middles of successive extremes."""
    rest = float(np.median(angles))
    for _ in range(5):
        sign = np.sign(angles - rest)
        edges = np.flatnonzero(np.diff(sign) != 0)
        extremes = [
            float(part[np.argmax(np.abs(part - rest))]) for part in np.split(angles, edges + 1)[1:-1] if len(part)
        ]
        if len(extremes) < 3:
            break
        e = np.array(extremes)
        rest = float(np.median((e[:-2] + 2 * e[1:-1] + e[2:]) / 4))
    return rest


def _start(times: Array, angles: Array, swings: Array, terms: tuple[str, ...]) -> Array:
    """Parameters near the right ones: the frequency from half swings, the damping from their amplitudes."""
    amplitude, duration = swings[:, 1], swings[:, 2]
    small = float(np.median(duration / (2 / math.pi * ellipk(np.sin(amplitude / 2) ** 2))))
    stiffness = (2 * math.pi / small) ** 2
    rate = float(np.polyfit(swings[:, 0], np.log(amplitude), 1)[0]) if len(swings) > 2 else 0.0
    rate, size = max(-rate, 1e-4), float(np.mean(amplitude))
    first = np.polyfit(times[:9] - times[0], angles[:9], 2)
    root = math.sqrt(stiffness)
    sizes = {
        "viscous_friction": 2 * rate,
        "quadratic_drag": rate * 3 * math.pi / (4 * root * size),
        "coulomb_friction": rate * math.pi / 2 * root * size,
    }
    share = 1 / max(1, len(terms))
    return np.array([math.log(stiffness), _rest(angles), first[2], first[1], *(share * sizes[term] for term in terms)])


def _rms(errors: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean([np.mean(e**2) for e in errors])))


def _chance(swings: Array, times: Array) -> float:
    """Factor by which mean squared errors of the held-out half swings may differ by chance.

    What no candidate explains is larger than noise, and lasts: a half swing counts as one, an F test compares.
    """
    number = int((swings[:, 0] > times[round(SPLITS[0] * len(times))]).sum())
    return float(f.ppf(PROBABILITY, max(2, number), max(2, number)))


def _period(fit: Fit) -> tuple[float, float, float]:
    """Small-amplitude period and its 90 % interval, s."""
    value, spread = fit.parameters[0], 1.645 * math.sqrt(max(0.0, fit.covariance[0, 0]))
    return tuple(2 * math.pi * math.exp(-x / 2) for x in (value, value + spread, value - spread))  # pyright: ignore


def _parameters(fit: Fit) -> dict[str, tuple[float, float, float, str]]:
    units = {"viscous_friction": "1/s", "quadratic_drag": "1/rad", "coulomb_friction": "rad/s²"}
    result = {}
    for i, term in enumerate(fit.motion.terms, COMMON):
        value, spread = float(fit.parameters[i]), 1.645 * math.sqrt(max(0.0, fit.covariance[i, i]))
        result[term] = (value, max(0.0, value - spread), value + spread, units[term])
    return result


def _named(terms: tuple[str, ...]) -> str:
    return " with ".join(map(phrase, terms)) or "none"
