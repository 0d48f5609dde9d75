"""The smallest effects that a comparison would find on a rig, from recordings of it as it is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.discrepancy.candidates import Columns
from keycld_model.diagnosis.discrepancy.changes import Candidate, Contest
from keycld_model.diagnosis.discrepancy.checks import check_runs
from keycld_model.diagnosis.discrepancy.following import followed
from keycld_model.diagnosis.discrepancy.motion import MOST, Motion
from keycld_model.diagnosis.discrepancy.regression import whitened_again
from keycld_model.diagnosis.discrepancy.regressors import force_of
from keycld_model.diagnosis.discrepancy.selection import between_runs
from keycld_model.diagnosis.inputs.checks import check
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.simulation.contacts import without_contacts


@dataclass(frozen=True)
class Detectable:
    """One parameter of an effect at a place.

    Attributes:
        effect: its id.
        kind: of the place.
        where: name of the place.
        parameter: of the effect, which is linear in it.
        size: least difference that would be found in one new run, in the parameter's unit; infinite if none would.
        unit: of the parameter.
        force: root mean square of the force that it makes along the recorded motion, N m or N; NaN for clocks.
    """

    effect: str
    kind: str
    where: str
    parameter: str
    size: float
    unit: str
    force: float


def detectable(
    recordings: Sequence[Recording],
    model: mujoco.MjModel,
    criteria: Criteria = STANDARD,
    advance: Callable[..., None] = lambda *_: None,
) -> list[Detectable]:
    """For every effect and place, about the smallest size that a comparison with these recordings would find.

    In one new run, to a factor of two or three.

    Effects with further, nonlinear parameters are tried with usual ones.

    Args:
        recordings: of the mechanism as it is, at least two.
        model: the simulator.
        criteria: thresholds.
        advance: of a progress bar of 100 steps.

    Raises:
        InputError: if the recordings do not suit the model, or are fewer than two.
    """
    check_runs(len(recordings))
    observation = JointPositions(model, criteria=criteria)
    check(recordings, model, observation, MOST)
    bare = without_contacts(model, recordings, observation)
    motion, terms, discrepancy = followed(recordings, len(recordings), bare, criteria)
    advance(30)
    columns, everything = Columns.of(motion), np.ones(len(motion.windows), dtype=bool)
    found = whitened_again(motion, terms, columns.answers, everything, discrepancy)
    zeros = [(i, term.spread) for i, term in enumerate(terms) if term.zero]
    numbers = tuple(range(len(recordings)))
    contest = Contest(found, columns.candidates, motion.windows.recording, numbers, (), zeros)
    advance(30)
    chance = between_runs(contest, criteria)
    advance(20)
    first = {
        candidate.key: candidate for candidate in reversed(columns.candidates) if candidate.hypothesis.coefficients
    }
    out = [d for c in first.values() for d in _of_candidate(c, contest, motion, chance.get(c.key, 0.0), criteria)]
    advance(20)
    return sorted(out, key=lambda d: (d.where, d.effect, d.parameter))


def _of_candidate(
    candidate: Candidate, contest: Contest, motion: Motion, chance: float, criteria: Criteria
) -> list[Detectable]:
    """Sizes whose gain is as many times that of chance as it must be, in the median run."""
    hypothesis = candidate.hypothesis
    sizes = [
        found_from(candidate, contest, [r for r in contest.baseline if r != run], [run], chance, criteria)
        for run in contest.baseline
    ]
    out = []
    for parameter, own in zip(hypothesis.coefficients, np.median(sizes, axis=0), strict=True):
        size, force = float(own if own < criteria.detectable * parameter.scale else np.inf), np.nan
        if np.isfinite(size) and not hypothesis.effect.observes:
            little = hypothesis.effect.with_parameters(**{parameter.name: parameter.absent + parameter.scale})
            made = np.sqrt(np.mean(force_of(motion, little) ** 2, axis=(0, 1))).max() / parameter.scale
            force = float(size * made)
        effect = hypothesis.effect
        out.append(
            Detectable(effect.id, effect.kind, effect.where, parameter.name, size, parameter.unit, round(force, 6))
        )
    return out


def found_from(
    candidate: Candidate,
    contest: Contest,
    baseline: Sequence[int],
    new: Sequence[int],
    chance: float,
    criteria: Criteria,
) -> NDArray[np.float64]:
    """Sizes of the coefficients `[k]` from which a difference gains as many times what chance does as it must.

    Args:
        candidate: what may differ.
        contest: in which it is tested.
        baseline: recordings.
        new: recordings.
        chance: nats that it gains between runs of the baseline.
        criteria: thresholds.
    """
    least = 2 * criteria.changed * max(chance, float(len(candidate.columns)))
    information = np.diag(np.linalg.pinv(contest.test(candidate, baseline, new).covariance))
    return np.sqrt(np.divide(least, information, out=np.full(len(information), np.inf), where=information > 0))
