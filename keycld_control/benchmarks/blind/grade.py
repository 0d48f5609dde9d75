"""How visible an effect is: what its true form gains in log-likelihood over the simulator with its nuisances refitted.

The one module of the generator that knows the diagnosis: of it, only the refit of masses, lengths, encoder zeros and
initial states, on the windows that it cuts. Nothing that is graded here changes a recording.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.blind.case import TRAINING, SealedCase, Signals, recording
from keycld_control.benchmarks.blind.film import Stage
from keycld_control.benchmarks.blind.mechanism import Array
from keycld_control.benchmarks.refitting import JointPositions, Problem, Simulator, at_most, refit, windowed
from keycld_model.diagnosis import Source

Grade = Literal["hidden", "marginal", "clear"]
MARGINAL, CLEAR = 3.0, 10.0
"""Least gains of effects that are marginal and clear, nats."""
FIRST_WINDOWS, ENOUGH = 20, 100.0
"""Number of windows that are refitted first, and gain that is enough there, nats."""
STEP = 0.01
"""Greatest step of the simulator, s; samples are a whole number of steps apart."""


def grade(nats: float) -> Grade:
    """The grade of a gain in log-likelihood."""
    return "clear" if nats > CLEAR else "marginal" if nats >= MARGINAL else "hidden"


def gain(case: SealedCase, signals: Sequence[Signals], noise: Array) -> float:
    """Nats that the true form gains over the refitted simulator on the training recordings.

    The refit is to positions without noise. Half the sum of squares that it leaves, over the noise's variance, is what
    the truth is expected to gain; the prior of the refitted nuisances counts too, less that of the true ones, so that
    an effect hides behind a mass only as far as masses are uncertain. If a few windows leave more than `ENOUGH`,
    that is returned, a lower bound: more windows cannot leave less. `noise` `[nv]` is the standard deviation of the
    positions: of an encoder, or the least that frames allow.
    """
    problem = noiseless(case, signals[:TRAINING], noise)
    few = _misfit(case, at_most(problem, FIRST_WINDOWS), iterations=8)
    return few if few > ENOUGH else _misfit(case, at_most(problem), iterations=15)


def noiseless(case: SealedCase, signals: Sequence[Signals], noise: Array) -> Problem:
    """True positions of recordings, cut into windows and weighed as if they had a noise of `[nv]` rad or m.

    Of filmed ones, those alone at which the mechanism is in the image.
    """
    simulator = _simulator(case.plan.system, 1 / case.rate / np.ceil(1 / case.rate / (STEP + 1e-4)))
    exact = [
        replace(s, noise=np.where(seen[:, None], case.zero, np.nan))
        for s, seen in zip(signals, _seen(case, signals), strict=True)
    ]
    clean = [recording(case, run, s) for run, s in enumerate(exact)]
    return windowed(simulator, clean, JointPositions(simulator.model, noise))


def _seen(case: SealedCase, signals: Sequence[Signals]) -> list[NDArray[np.bool_]]:
    """Of each recording, `[Ts]` whether its sensor shows the mechanism: encoders do, cameras where it is in view."""
    if case.film is None:
        return [np.ones(len(s.true), bool) for s in signals]
    stage = Stage(case.plan.system, case.errors)
    return [stage.in_image(s.true, case.film) for s in signals]


def _misfit(case: SealedCase, problem: Problem, iterations: int) -> float:
    """Nats that a refit leaves unexplained."""
    fit, true = refit(problem, (), iterations), true_nuisances(case, problem)
    prior = np.sum((fit.point.variant.values / problem.spreads) ** 2 - (true / problem.spreads) ** 2)
    return float(0.5 * (np.sum(problem.residual(fit.point) ** 2) + prior))


def true_nuisances(case: SealedCase, problem: Problem) -> Array:
    """The values of the nuisances in this case, logarithms of factors and zeros in rad or m."""
    model, errors = problem.simulator.model, {"mass": case.errors.mass, "length": case.errors.length}
    return np.array(
        [
            case.zero[n.index] if n.kind == "zero" else np.log(errors[n.kind][model.body(n.index).name])
            for n in problem.nuisances
        ]
    )


def gains(case: SealedCase, signals: Sequence[Signals], noise: Array) -> tuple[float, list[float]]:
    """Nats of all mechanisms together, and of each.

    In a set, each is graded by injecting it alone into the same plant with the same starts, commands and noise: what it
    would gain if nothing else were missing. Refits with the others present would need their exact forms.
    """
    together = gain(case, signals, noise)
    if len(case.mechanisms) < 2:
        return together, [together] * len(case.mechanisms)
    singles = []
    for mechanism in case.mechanisms:
        alone = case.with_only(mechanism)
        runs = alone.simulate(range(TRAINING))
        singles.append(together if runs is None else gain(alone, runs, noise))
    return together, singles


@lru_cache(maxsize=8)
def _simulator(system: str, step: float) -> Simulator:
    return Simulator(Source.of_environment(system).model, step, threads=1)
