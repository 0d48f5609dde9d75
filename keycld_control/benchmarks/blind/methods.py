"""What can be benchmarked: functions of recordings, held-out recordings and a simulator that return a report."""

from collections.abc import Callable, Sequence
from typing import Any

import mujoco

from keycld_control.benchmarks.named_functions import function_of
from keycld_envs.recordings import Recording

Method = Callable[[Sequence[Recording], Sequence[Recording], mujoco.MjModel], dict[str, Any]]
"""The report has the fields of `keycld.diagnosis/1` that it can fill: verdict, findings, unexplained, fit."""
METHODS = {
    "diagnose": "keycld_control.benchmarks.blind.methods:diagnose",
    "refit": "keycld_control.benchmarks.blind.baselines.refit:refit",
    "greedy": "keycld_control.benchmarks.blind.baselines.greedy:greedy",
    "sindy": "keycld_control.benchmarks.blind.baselines.sindy:sindy",
    "neural": "keycld_control.benchmarks.blind.baselines.neural:neural",
}
"""Where each is, by name; a place of one's own is "module:function" too."""


def get_method(name: str) -> Method:
    """A registered method, or one of your own as "module:function".

    Raises:
        InputError: if there is none.
    """
    return function_of(name, METHODS)


def diagnose(training: Sequence[Recording], held_out: Sequence[Recording], model: mujoco.MjModel) -> dict[str, Any]:
    """The diagnosis that is measured; of recordings without joint positions, from their frames."""
    from keycld_model import diagnosis

    if training[0].qpos is None:
        return diagnosis.diagnose_images(training, model, held_out, workers=1).to_dict()
    return diagnosis.diagnose(training, model, held_out).to_dict()
