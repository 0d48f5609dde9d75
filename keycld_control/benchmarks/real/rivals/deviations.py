"""What changed, by numbers that are estimated from two sets and differ beyond their standard deviations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.real.rivals.answer import Answer, Change
from keycld_model.diagnosis.verdict.report import Estimate

Array = NDArray[np.float64]
ALARM = 3.0
"""Standard deviations from which a difference is told; by chance, one number in 370 differs by so much."""
NINETY = 1.645
"""Standard deviations of half a 90 % interval."""


@dataclass(frozen=True)
class Difference:
    """How something at a joint differs.

    Attributes:
        effect: id of the taxonomy, or "unknown".
        where: name of the joint or motor.
        joint: there.
        parameters: the effect's size, by name.
        deviations: of the difference, of the number that differs most.
    """

    effect: str
    where: str
    joint: str
    parameters: dict[str, Estimate]
    deviations: float


def estimate(value: float, variance: float, unit: str) -> Estimate:
    """A number with its 90 % interval."""
    half = NINETY * float(np.sqrt(variance))
    return Estimate(value, unit, value - half, value + half)


def answer(differences: Sequence[Difference]) -> Answer:
    """The greatest difference, if it is beyond `ALARM`; others beyond it at that joint are its rivals.

    Differences that are no effect, such as friction that fell, alarm too, but effects are named before them.
    """
    order = sorted(differences, key=lambda d: -d.deviations)
    deviations: dict[str, float] = {}
    for d in order:  # an effect of several numbers has that of the first
        deviations.setdefault(f"{d.effect} at {d.where}", round(d.deviations, 2))
    told = {"deviations": deviations}
    beyond = [d for d in order if d.deviations > ALARM]
    if not beyond:
        return Answer("no_mismatch", details=told)
    beyond.sort(key=lambda d: d.effect == "unknown")  # which keeps the order otherwise
    first = beyond[0]
    rivals = [d.effect for d in beyond[1:] if d.joint == first.joint]
    return Answer("mismatch", [Change(first.effect, first.where, first.parameters, rivals)], details=told)


def covariance(jacobian: Array, residual: Array, block: NDArray[np.int64]) -> Array:
    """Covariance `[P, P]` of a least-squares estimate whose residuals are independent only between blocks.

    Residuals of real mechanisms go on for long; as if each were independent, standard deviations would be far too
    small (Liang and Zeger, 1986).

    Args:
        jacobian: `[N, P]` of the residuals.
        residual: `[N]`.
        block: `[N]` of each residual, from 0.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    scores = np.zeros((int(block.max()) + 1, jacobian.shape[1]))
    np.add.at(scores, block, jacobian * residual[:, None])
    return inverse @ (scores.T @ scores) @ inverse
