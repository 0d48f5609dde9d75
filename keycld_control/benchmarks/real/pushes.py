"""How well the pushes that a diagnosis finds are those that a recording logs."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis import Report

Array = NDArray[np.float64]
EDGE = 0.1
"""Share of a push's greatest torque at which its window begins and ends."""
Span = tuple[float, float]


@dataclass(frozen=True)
class PushScore:
    """Pushes found against true ones.

    Attributes:
        overlaps: greatest intersection over union of each true push with one found at its joint.
        false: number of those found where nothing pushes at their joint, weakly or strongly.
        auc: area under the ROC curve over the samples of all joints; None without true pushes.
    """

    overlaps: list[float]
    false: int
    auc: float | None


def true_windows(clock: Array, torque: Array, strong: float) -> list[Span]:
    """When a torque `[N]` pushes with more than `strong`, s."""
    inside = np.abs(torque) > EDGE * strong
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    spans = []
    for a, b in edges.reshape(-1, 2):
        size = np.abs(torque[a:b])
        if size.max() > strong:
            above = a + np.flatnonzero(size > EDGE * size.max())
            spans.append((float(clock[above[0]]), float(clock[above[-1]])))
    return spans


def found_windows(report: Report, recording: str, joint: str) -> list[tuple[Span, float]]:
    """Windows of the pushes that a report places in a recording at a joint, s, and their torques, N m."""
    out = []
    for finding in report.findings:
        if finding.effect == "external_pulse" and finding.where["name"] == joint:
            by_recording = finding.when_by_recording
            spans = finding.when or () if by_recording is None else by_recording.get(recording, ())
            out += [((float(a), float(b)), finding.parameters["f"].value) for a, b in spans]
    return out


def overlap(a: Span, b: Span) -> float:
    """Intersection over union of two windows."""
    both = max(0.0, min(a[1], b[1]) - max(a[0], b[0]))
    return both / (a[1] - a[0] + b[1] - b[0] - both)


def auc(score: Array, label: NDArray[np.bool_]) -> float:
    """Probability that a positive sample scores above a negative one, ties counted half."""
    order = np.unique(score, return_inverse=True)[1]
    counts = np.bincount(order)
    rank = (np.cumsum(counts) - (counts - 1) / 2)[order]
    positives = int(label.sum())
    return float((rank[label].sum() - positives * (positives + 1) / 2) / (positives * (len(label) - positives)))


def score(report: Report, recording: str, clock: Array, torques: Mapping[str, Array], strong: float) -> PushScore:
    """Compare the pushes of a report with true ones.

    Args:
        report: of the diagnosis.
        recording: its id.
        clock: `[N]` s.
        torques: `[N]` of the pushes, by joint, N m.
        strong: torque of those that must be found, N m.
    """
    overlaps, false, guess = [], 0, {joint: np.zeros_like(clock) for joint in torques}
    for joint, torque in torques.items():
        found = found_windows(report, recording, joint)
        true = true_windows(clock, torque, strong)
        overlaps += [max((overlap(span, window) for window, _ in found), default=0.0) for span in true]
        pushed = np.abs(torque) > EDGE * strong
        false += sum(not pushed[(clock >= a) & (clock <= b)].any() for (a, b), _ in found)
        for (a, b), f in found:
            guess[joint][(clock >= a) & (clock < b)] += abs(f)
    label = np.concatenate([np.abs(torque) for torque in torques.values()]) > EDGE * strong
    area = auc(np.concatenate(list(guess.values())), label) if label.any() else None
    return PushScore([round(o, 3) for o in overlaps], false, area)
