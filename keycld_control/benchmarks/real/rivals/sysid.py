"""MuJoCo's own system identification (mujoco.sysid) on each of both sets; needs the extra `sysid`."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np

from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_control.benchmarks.real.rivals.deviations import Array, Difference, answer, covariance, estimate
from keycld_control.benchmarks.real.rivals.sysid_pieces import Pieces
from keycld_control.benchmarks.real.rivals.sysid_terms import Term, changeable, edited, fixed
from keycld_envs.effects import Effect, effect_class
from keycld_envs.optional import MissingPackage
from keycld_envs.recordings import Recording

ITERATIONS = 12
"""Of Gauss and Newton at most."""
CONVERGED = 1e-3
"""Relative step after which a fit ends."""
AT_BOUND = 1e-6
"""Share of a range from its ends within which a number is at a bound, and free no more."""
STEP = 1e-5
"""Of finite differences, in units of each number; frictions are smooth only beyond MuJoCo's solver's tolerance."""


@dataclass(frozen=True)
class Fit:
    """Numbers that were identified in one set.

    Attributes:
        values: `[P]`.
        variances: `[P]`; zero of numbers at a bound, which the others' variances do not count either.
    """

    values: Array
    variances: Array


def sysid(new: Sequence[Recording], baseline: Sequence[Recording], model: mujoco.MjModel) -> Answer:
    """The number that differs most between the sets.

    Masses, rotors and zeros of encoders are identified in the baseline, with motors as they are believed to be, and are
    the same in both sets; frictions, springs, constant forces, gains and delays are identified in each.

    Raises:
        MissingPackage: if what mujoco.sysid imports is not installed.
    """
    toolbox = installed()
    before, after = (Pieces.of(part, model) for part in (baseline, new))
    own, always = changeable(model), fixed(model)
    at_motors = {term.name for term in own if term.of_motor}
    first = _identified(toolbox, before, model, [*always, *(t for t in own if t.name not in at_motors)])
    settled = [t.starting(v) for t, v in zip(always, first.values, strict=False)]
    a, b = (_identified(toolbox, part, model, own, settled) for part in (before, after))
    variances = a.variances + b.variances
    return answer([_difference(*numbers) for numbers in zip(own, b.values - a.values, variances, strict=True)])


def simulator_of(
    recordings: Sequence[Recording], model: mujoco.MjModel
) -> tuple[mujoco.MjModel, tuple[Effect, ...], Array]:
    """All numbers, identified in one set of recordings.

    Returns:
        The model with masses and rotors; frictions, springs, constant forces, gains and delays; and zeros `[nq]` of the
        encoders, rad or m.

    Raises:
        MissingPackage: if what mujoco.sysid imports is not installed.
    """
    pieces, own, always = Pieces.of(recordings, model), changeable(model), fixed(model)
    values = _identified(installed(), pieces, model, [*always, *own]).values.tolist()
    numbers = {t.name: value for t, value in zip([*always, *own], values, strict=True)}
    effects = tuple(_effect(t, numbers[t.name]) for t in own)
    zeros = [numbers[f"encoder_zero at {model.joint(j).name}"] for j in range(model.njnt)]
    return edited(model, always, numbers, model.opt.timestep), effects, np.array(zeros)


def installed() -> Any:
    """The package mujoco.sysid.

    Raises:
        MissingPackage: if something that it imports is not installed.
    """
    from mujoco import sysid as toolbox  # without what it imports, it is empty

    if not hasattr(toolbox, "model_residual"):
        raise MissingPackage("The method sysid needs what mujoco.sysid imports; run pip install 'keycld[sysid]'.")
    return toolbox


def _identified(
    toolbox: Any, pieces: Pieces, model: mujoco.MjModel, terms: Sequence[Term], settled: Sequence[Term] = ()
) -> Fit:
    """Numbers of the terms, with others as they were settled."""
    held = {t.name: t.start for t in settled}

    def built(parameters: Any) -> mujoco.MjModel:
        values = {t.name: float(parameters[t.name].value[0]) for t in terms}
        return edited(model, [*terms, *settled], held | values, pieces.step)

    parameters = toolbox.ParameterDict()
    for t in terms:
        parameters.add(toolbox.Parameter(t.name, t.start, t.low, t.high))
    trajectories = pieces.trajectories(toolbox, edited(model, [], {}, pieces.step))

    def residual(x: Array, given: Any) -> tuple[list[Array], Any, Any]:
        flat, predicted, measured = toolbox.model_residual(
            x,
            given,
            built,
            trajectories,
            modify_residual=partial(pieces.residual, held),
            custom_rollout=partial(pieces.rollout, toolbox, held),
            n_threads=1,
            resample_true=False,
        )
        return [pieces.together(flat, x)], predicted, measured

    found, result = toolbox.optimize(
        parameters,
        residual,
        optimizer="mujoco",
        verbose=False,
        max_iters=ITERATIONS,
        x_scale="jac",
        eps=STEP,
        xtol=CONVERGED,
        output=io.StringIO(),
    )
    values = found.as_vector()
    left = residual(values, found)[0][0]
    block = np.repeat(np.arange(len(trajectories)), left.size // len(trajectories))
    low, high = found.get_bounds()
    free = np.minimum(values - low, high - values) > AT_BOUND * (high - low)
    variances = np.zeros_like(values)
    variances[free] = np.diag(covariance(np.asarray(result.jac)[:, free], left, block))
    return Fit(values, variances)


def _effect(term: Term, value: float) -> Effect:
    """A term as an effect."""
    kind = effect_class(term.effect, "actuator" if term.of_motor else "joint")
    assert kind is not None, term.effect
    return kind(term.where).with_parameters(**{term.parameter: value})


def _difference(term: Term, change: float, variance: float) -> Difference:
    """A term's difference as an effect; friction that fell is none."""
    deviations = float(abs(change) / np.sqrt(max(variance, 1e-300)))
    if term.grows and change < 0:
        return Difference("unknown", term.where, term.joint, {}, deviations)
    size = estimate(term.absent + change, variance, term.unit)
    return Difference(term.effect, term.where, term.joint, {term.parameter: size}, deviations)
