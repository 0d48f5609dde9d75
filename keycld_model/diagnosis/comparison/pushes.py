"""Pushes from outside in the new recordings, stronger than what looks like one in the baseline."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.comparison.changes import Column, Contest
from keycld_model.diagnosis.comparison.motion import Motion
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.simulation.variant import Pulse

Array = NDArray[np.float64]


def pushes(contest: Contest, motion: Motion, criteria: Criteria, present: list[Column]) -> list[Pulse]:
    """Rectangles of force at one joint, at most one per joint and window, joined where they touch.

    Each must gain its price and half as much again as the best of the same joint in the baseline, beside the changes.
    """
    response = motion.response
    (windows, _, nv, parts), c = response.shape, contest.regression
    white = c.white(response.reshape(windows, response.shape[1], -1)).reshape(response.shape)
    left = contest.left(present)
    total = np.concatenate([np.zeros((*white.shape[:-1], 1)), np.cumsum(white, axis=-1)], axis=-1)
    first, last = np.triu_indices(parts + 1, 1)
    spans = total[..., last] - total[..., first]
    along, power = np.einsum("wrjs,wr->wjs", spans, left), np.maximum(np.einsum("wrjs,wrjs->wjs", spans, spans), 1e-9)
    gain = 0.5 * along**2 / power
    of_baseline = np.isin(contest.recording, contest.baseline)
    found = []
    edges = motion.windows.edges(parts) * motion.windows.step
    for j in range(nv):
        least = max(criteria.pulse, 1.5 * float(gain[of_baseline, j].max()))
        for w in np.flatnonzero(~of_baseline):
            s = int(gain[w, j].argmax())
            others = gain[w].max(axis=1)
            if gain[w, j, s] >= least and others.argmax() == j:
                start, end = motion.windows.start[w] + edges[[first[s], last[s]]]
                force = float(along[w, j, s] / power[w, j, s])
                found.append(Pulse(int(motion.windows.recording[w]), j, float(start), float(end - start), force))
    return found


@dataclass(frozen=True)
class Overlap:
    """How much of the new recordings is beyond what the baseline shows.

    Attributes:
        channel: such as "speed of elbow".
        share: of the time.
    """

    channel: str
    share: float


def beyond_baseline(motion: Motion, baseline: NDArray[np.bool_]) -> list[Overlap]:
    """Channels in which new recordings leave the range of the baseline, widened by a tenth."""
    model, out = motion.model, []
    for kind, values, names in (
        ("position", motion.q, [model.joint(j).name for j in range(model.njnt)]),
        ("speed", motion.v, [model.joint(j).name for j in range(model.njnt)]),
        ("command", motion.u, [model.actuator(i).name for i in range(model.nu)]),
    ):
        for i, name in enumerate(names):
            before, after = values[baseline][..., i], values[~baseline][..., i]
            low, high = np.quantile(before, [0.005, 0.995])  # single samples do not count
            margin = 0.1 * (high - low)
            share = float(np.mean((after < low - margin) | (after > high + margin)))
            out.append(Overlap(f"{kind} of {name}", share))
    return out
