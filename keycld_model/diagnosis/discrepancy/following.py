"""The motion of recordings by a simulator whose masses are near theirs."""

from collections.abc import Sequence

import mujoco
import numpy as np

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.covariance import Discrepancy
from keycld_model.diagnosis.discrepancy.inertias import with_own_masses
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regression import regression
from keycld_model.diagnosis.discrepancy.regressors import Term, shared_terms

CORRECTIONS = 4
"""Times that masses are fitted at most, before a simulator follows the recordings: each is by a factor of two."""


def followed(
    recordings: Sequence[Recording], baseline: int, model: mujoco.MjModel, criteria: Criteria
) -> tuple[Motion, list[Term], Discrepancy]:
    """The motion, what all of it shares, and what that leaves, by a simulator with masses near those of the baseline.

    Args:
        recordings: those of the baseline first.
        baseline: how many are of the baseline.
        model: the simulator.
        criteria: thresholds.
    """
    near = criteria.spreads.mass_beside_forces
    for _ in range(CORRECTIONS):
        motion = Motion.of(recordings, model, criteria)
        terms, own = shared_terms(motion, criteria), motion.windows.recording < baseline
        nothing = motion.residual[..., None][..., :0]
        found, discrepancy = regression(motion, terms, nothing, own)
        values = found.solve(own, nothing[own], np.zeros(0)).values
        numbers = {term.name: float(value) for term, value in zip(terms, values, strict=True)}
        after = with_own_masses(motion, numbers, criteria, near)
        if after is None:
            break
        model, near = after, criteria.spreads.mass
    return motion, terms, discrepancy
