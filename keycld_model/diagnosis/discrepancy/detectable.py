"""The smallest effects that a comparison would find on a rig, from recordings of it as it is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.discrepancy.candidates import Columns
from keycld_model.diagnosis.discrepancy.changes import Candidate, Contest
from keycld_model.diagnosis.discrepancy.checks import check_runs
from keycld_model.diagnosis.discrepancy.motion import MOST, Motion
from keycld_model.diagnosis.discrepancy.regression import regression
from keycld_model.diagnosis.discrepancy.regressors import force_of, shared_terms
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
    motion = Motion.of(recordings, bare, criteria)
    advance(30)
    terms, columns = shared_terms(motion, criteria), Columns.of(motion)
    everything = np.ones(len(motion.windows), dtype=bool)
    found, _ = regression(motion, terms, columns.answers, everything)
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
    hypothesis, k = candidate.hypothesis, len(candidate.columns)
    least = 2 * criteria.changed * max(chance, float(k))
    information = []
    for run in contest.baseline:
        tested = contest.test(candidate, [r for r in contest.baseline if r != run], [run])
        information.append(np.diag(np.linalg.pinv(tested.covariance)))
    out = []
    for parameter, info in zip(hypothesis.coefficients, np.median(information, axis=0), strict=True):
        size = float(np.sqrt(least / info)) if info > 0 else np.inf
        force = np.nan
        if np.isfinite(size) and not hypothesis.effect.observes:
            little = hypothesis.effect.with_parameters(**{parameter.name: parameter.absent + parameter.scale})
            made = np.sqrt(np.mean(force_of(motion, little) ** 2, axis=(0, 1))).max() / parameter.scale
            force = float(size * made)
        effect = hypothesis.effect
        out.append(
            Detectable(effect.id, effect.kind, effect.where, parameter.name, size, parameter.unit, round(force, 6))
        )
    return out
