"""Commands that a simulator cuts off."""

from collections.abc import Iterable

import mujoco
import numpy as np

from keycld_envs.recordings.recording import Recording

ROUNDING = 1e-6
"""Of a limit; commands that are beyond it by less are at it."""


def beyond_limits(recordings: Iterable[Recording], model: mujoco.MjModel) -> list[str]:
    """What motors are told beyond their range, a sentence for the worst command of each motor.

    Args:
        recordings: with commands of all motors of the model, or none.
        model: the simulator.
    """
    worst: dict[int, tuple[float, str, float]] = {}
    for recording in recordings:
        if recording.action is None or not len(recording.action) or recording.action.shape[1] != model.nu:
            continue
        for i in map(int, np.flatnonzero(model.actuator_ctrllimited)):
            low, high = model.actuator_ctrlrange[i]
            told = np.asarray(recording.action, np.float64)[:, i]
            beyond = np.maximum(told - high, low - told)
            k = int(np.argmax(beyond))
            if beyond[k] > max(ROUNDING * (high - low), worst.get(i, (0.0,))[0]):
                worst[i] = float(beyond[k]), recording.id, float(told[k])
    return [
        f"{model.actuator(i).name!r} is told {told:.4g} in recording {name!r}, beyond its range of "
        f"{model.actuator_ctrlrange[i][0]:g} to {model.actuator_ctrlrange[i][1]:g} in the simulator, which cuts it off"
        for i, (_, name, told) in sorted(worst.items())
    ]
