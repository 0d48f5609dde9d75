"""Where new recordings leave what the baseline shows."""

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.inputs.ranges import Paths, beyond

Beyond = dict[str, NDArray[np.bool_]]
"""Channels, and where they leave the range of the baseline, `[W, S]`; see `beyond`."""


def beyond_baseline(motion: Motion, baseline: NDArray[np.bool_]) -> Beyond:
    """Where windows leave the range of those of the baseline."""
    paths = Paths(motion.q, motion.v, motion.u)
    return beyond(motion.model, Paths(*(x[baseline] for x in paths)), paths)


def comparable(found: Beyond, baseline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Windows of the baseline, and those that hardly leave its positions and speeds, `[W]`; commands may change."""
    anywhere = np.any([b for channel, b in found.items() if not channel.startswith("command")], axis=0)
    return baseline | (anywhere.mean(axis=1) <= 0.1)
