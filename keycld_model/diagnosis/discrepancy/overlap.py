"""Where new recordings leave what the baseline shows."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.discrepancy.motion import Motion


@dataclass(frozen=True)
class Overlap:
    """How much of the new recordings is beyond what the baseline shows.

    Attributes:
        channel: such as "speed of elbow".
        share: of the time.
    """

    channel: str
    share: float


def comparable(motion: Motion, baseline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Windows of the baseline, and those that hardly leave its positions and speeds, `[W]`; commands may change."""
    beyond = np.any([b for channel, b in _beyond(motion, baseline) if not channel.startswith("command")], axis=0)
    return baseline | (beyond.mean(axis=1) <= 0.1)


def beyond_baseline(motion: Motion, baseline: NDArray[np.bool_]) -> list[Overlap]:
    """Channels in which new recordings leave the range of the baseline, widened by a tenth."""
    return [Overlap(channel, float(beyond[~baseline].mean())) for channel, beyond in _beyond(motion, baseline)]


def _beyond(motion: Motion, baseline: NDArray[np.bool_]) -> list[tuple[str, NDArray[np.bool_]]]:
    """Channels, and where they leave the range of the baseline, `[W, S]`; hinges that turn round have none."""
    model = motion.model
    joints, motors = ([x(i).name for i in range(n)] for x, n in ((model.joint, model.njnt), (model.actuator, model.nu)))
    channels = [("position", motion.q, joints), ("speed", motion.v, joints), ("command", motion.u, motors)]
    out = []
    for kind, values, names in channels:
        for i, name in enumerate(names):
            x = values[..., i]
            if kind == "position" and model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE:
                x = np.mod(x + np.pi, 2 * np.pi) - np.pi
            low, high = np.quantile(x[baseline], [0.005, 0.995])  # single samples do not count
            margin = 0.1 * (high - low)
            out.append((f"{kind} of {name}", (x < low - margin) | (x > high + margin)))
    return out
