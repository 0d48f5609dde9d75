"""The comparison of `keycld diagnose --baseline`."""

from collections.abc import Sequence

import mujoco

from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import diagnose


def comparison(new: Sequence[Recording], baseline: Sequence[Recording], model: mujoco.MjModel) -> Answer:
    """What changed since the baseline."""
    return Answer.of_report(diagnose(new, model, baseline=baseline))
