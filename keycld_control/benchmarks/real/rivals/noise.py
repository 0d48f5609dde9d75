"""The search that weighs misfit by the sensors' noise, on the new recordings alone."""

import math
from collections.abc import Sequence
from dataclasses import replace

import mujoco

from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_control.benchmarks.real.rivals.one_set import BUDGET
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD

ALWAYS = replace(STANDARD, far_above_noise=math.inf)
"""No misfit is too far above noise for the search."""


def noise(new: Sequence[Recording], baseline: Sequence[Recording], model: mujoco.MjModel) -> Answer:
    """What the new recordings lack, as if only noise could be left."""
    return Answer.of_report(diagnose(new, model, criteria=ALWAYS, budget=BUDGET))
