"""What may have changed, and how its size and form are found."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from keycld_envs.effects import ActuatorGain, Effect, Parameter
from keycld_envs.effects.places import ActuatorEffect
from keycld_model.diagnosis.discrepancy.changes import Candidate, Column, Contest, Difference
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regressors import answer_of, can_be_tested, spread_of_share
from keycld_model.diagnosis.search.hypotheses import Hypothesis, hypotheses, recorded_range

Array = NDArray[np.float64]
NEAR = 0.1
"""Share of the range in which a nonlinear parameter is looked for at first, around its value on the grid."""
Test = Callable[[Contest, Candidate], Difference]


@dataclass(frozen=True)
class Columns:
    """Candidates, and the columns of them all.

    Attributes:
        candidates: each with indices of its columns.
        answers: `[W, r, C]` fall of whitened residuals per unit of each coefficient.
    """

    candidates: tuple[Candidate, ...]
    answers: Array

    @classmethod
    def of(cls, motion: Motion) -> "Columns":
        """All effects at all places that can be tested along a motion."""
        candidates: list[Candidate] = []
        answers: list[Array] = []
        for hypothesis in hypotheses(motion.model, recorded_range(motion.windows)):
            if can_be_tested(hypothesis.effect, motion.model):
                own = answers_of(motion, hypothesis)
                columns = tuple(range(len(answers), len(answers) + len(own)))
                candidates.append(Candidate(hypothesis, columns, precision=_precision(motion, hypothesis)))
                answers += own
        return cls(tuple(candidates), np.stack(answers, axis=-1))


def _precision(motion: Motion, hypothesis: Hypothesis) -> float:
    """Of what both sets have of an effect: nothing is known but of motors, which are nearly what the simulator says.

    With masses and the only motor free, nothing would need any force at all, were both zero. So its gain stays that of
    the simulator, for which masses make up. Where there are several, all of them held are worse: a motor that does
    nothing but make up for friction has the gain of any friction. Dead zones change the torque by a share.
    """
    effect = hypothesis.effect
    if not isinstance(effect, ActuatorEffect) or effect.memory:
        return 0.0
    if isinstance(effect, ActuatorGain):
        return 1e12 if motion.model.nu == 1 else 0.0
    spreads = [spread_of_share(motion, effect, number) for number in hypothesis.coefficients]
    return min(spreads, default=np.inf) ** -2.0


def answers_of(motion: Motion, hypothesis: Hypothesis, sizes: Sequence[float] | None = None) -> list[Array]:
    """One column `[W, r]` per coefficient, per unit of it; of the effect as it is, if it has none.

    Args:
        motion: along which it acts.
        hypothesis: the effect.
        sizes: of the coefficients, where the effect is no line; small ones by default.
    """
    if not hypothesis.coefficients:
        return [answer_of(motion, hypothesis.effect)]
    amounts = [p.scale for p in hypothesis.coefficients] if sizes is None else sizes
    return [
        answer_of(motion, replace(hypothesis.effect, **{p.name: p.absent + amount})) / amount
        for p, amount in zip(hypothesis.coefficients, amounts, strict=True)
    ]


BESIDE = 0.02
"""Share of a nonlinear parameter's value by which it is moved to see how the gain bends."""


def bent(contest: Contest, motion: Motion, found: Difference, parameter: Parameter, present: Sequence[Column]) -> float:
    """Minus the second derivative of a difference's gain by a nonlinear parameter, its coefficients fitted anew."""
    hypothesis, sizes = found.candidate.hypothesis, np.abs(found.values).tolist() if found.candidate.changed else None
    value = float(getattr(hypothesis.effect, parameter.name))
    step, gains = BESIDE * max(abs(value), 0.1 * parameter.scale), []
    for x in (value - step, value + step):
        now = replace(hypothesis, effect=replace(hypothesis.effect, **{parameter.name: x}))
        before, answers = contest.regression.others.shape[2], np.stack(answers_of(motion, now, sizes), axis=-1)
        own = contest.with_regression(contest.regression.with_others(answers))
        columns = tuple(range(before, before + answers.shape[-1]))
        anew = {"columns": columns} if sizes is None else {"changed": columns}
        candidate = replace(found.candidate, hypothesis=now, **anew)
        gains.append(own.test(candidate, own.baseline, own.new, present).gain)
    return (2 * found.gain - sum(gains)) / step**2


def refined(contest: Contest, motion: Motion, found: Difference, test: Test) -> tuple[Contest, Difference]:
    """A difference with its nonlinear parameters where it gains most, and a contest with its columns.

    Each parameter is looked for by itself, between values around the one that it was found with (Brent, 1973).
    """
    hypothesis = found.candidate.hypothesis
    best = (contest, found)

    def tried(effect: Effect, sizes: Sequence[float] | None = None) -> tuple[Contest, Difference]:
        now, before = replace(hypothesis, effect=effect), contest.regression.others.shape[2]
        answers = np.stack(answers_of(motion, now, sizes), axis=-1)
        own = contest.with_regression(contest.regression.with_others(answers))
        columns = tuple(range(before, before + answers.shape[-1]))
        anew = {"hypothesis": now, "columns": columns} if sizes is None else {"changed": columns}
        candidate = replace(found.candidate, **anew)
        return own, test(own, candidate)

    def searched(at: Callable[[float], tuple[Contest, Difference]], low: float, high: float) -> None:
        nonlocal best
        seen: dict[float, tuple[Contest, Difference]] = {}

        def cost(x: float) -> float:
            seen[x] = at(float(x))
            return -seen[x][1].gain

        options = {"maxiter": 12, "xatol": 0.01 * (high - low)}
        minimize_scalar(cost, bounds=(low, high), method="bounded", options=options)
        best = max([best, *seen.values()], key=lambda pair: pair[1].gain)

    for parameter in [p for p in hypothesis.effect.parameters() if p.grid]:
        now = best[1].candidate.hypothesis.effect
        value = float(getattr(now, parameter.name))
        for part in (NEAR, 1.0):  # of periods and waves, many values are better than those beside them
            times, more = 1 + 1.5 * part, 0.5 * part
            low, high = (value / times, value * times) if value > 0 else (value - more, value + more)
            low, high = max(low, parameter.low), min(high, parameter.high)
            searched(lambda x, now=now, name=parameter.name: tried(replace(now, **{name: x})), low, high)
    if isinstance(hypothesis.effect, ActuatorEffect) and len(hypothesis.coefficients) == 1:  # no line
        size = abs(float(best[1].values[0]))
        now = best[1].candidate.hypothesis.effect
        searched(lambda x: tried(now, [float(np.exp(x))]), np.log(size / 2), np.log(size * 6))
    return best
