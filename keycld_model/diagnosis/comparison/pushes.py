"""Pushes from outside in the new recordings, stronger than what looks like one in the baseline."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.comparison.changes import Column, Contest
from keycld_model.diagnosis.comparison.motion import Motion
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.simulation.variant import Pulse

Array = NDArray[np.float64]


def pushes(contest: Contest, motion: Motion, criteria: Criteria, present: list[Column]) -> list[Pulse]:
    """Rectangles of force at one joint, at most one per joint and window.

    Each must gain its price, and more than what looks most like one at the same joint in the baseline, by a factor of
    the criteria. Where they seem to be everywhere, it is something else.
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
    beyond = criteria.push_beside_changes if present else criteria.push
    edges = motion.windows.edges(parts) * motion.windows.step
    for j in range(nv):
        least = max(criteria.pulse, beyond * float(gain[of_baseline, j].max()))
        for w in np.flatnonzero(~of_baseline):
            s = int(gain[w, j].argmax())
            others = gain[w].max(axis=1)
            if gain[w, j, s] >= least and others.argmax() == j:
                start, end = motion.windows.start[w] + edges[[first[s], last[s]]]
                force = float(along[w, j, s] / power[w, j, s])
                found.append(Pulse(int(motion.windows.recording[w]), j, float(start), float(end - start), force))
    few = criteria.push_share * max(1, int(np.isin(contest.recording, contest.new).sum()))
    return found if len(found) <= few else []


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
