"""The diagnosis of the new recordings alone: what is missing, not what changed."""

from collections.abc import Sequence

import mujoco

from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import diagnose

BUDGET = 60.0
"""Seconds after which a search without a baseline ends with the best it has; a comparison takes about 20."""


def one_set(new: Sequence[Recording], baseline: Sequence[Recording], model: mujoco.MjModel) -> Answer:
    """What the new recordings lack; of a single one, its last third is held out."""
    return Answer.of_report(diagnose(new, model, budget=BUDGET))
