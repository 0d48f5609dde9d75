"""R1: pushes at a double pendulum, which nobody tells the diagnosis about."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.real import dfki
from keycld_control.benchmarks.real.gate import Array, DataSplit, Diagnosed, Gate, Outcome
from keycld_envs.recordings.importers import Table
from keycld_model.diagnosis import Report

PUSHED = {
    "acrobot": "acrobot/real_hardware_perturbed_v2/src_data/ilqr_tvlqr_lqr/experiment01",
    "pendubot": "pendubot/real_hardware_perturbed_v2/src_data/ilqr_tvlqr_lqr/experiment01",
}
UNDISTURBED = dfki.run_file(dfki.ILQR_TVLQR_LQR, "undisturbed", "tau_con")
STRONG = 0.2
"""Torque of the pushes that must be found, N m."""
EDGE = 0.1
"""Share of a push's greatest torque at which its window begins and ends."""
OVERLAP, AUC = 0.7, 0.97
"""Least intersection over union with every push, and least area under the ROC curve."""
Span = tuple[float, float]


@dataclass(frozen=True)
class PulseScore:
    """How well the pulses of a report are the pushes of the recording.

    Attributes:
        overlaps: greatest intersection over union of each true push with a pulse at its joint.
        false: number of pulses that meet no push.
        auc: area under the ROC curve over the samples of both joints; None without pushes.
    """

    overlaps: list[float]
    false: int
    auc: float | None


def pushes(logged: Table) -> Array:
    """The torques that were added as a disturbance, `[N, 2]`, N m; zero in undisturbed runs."""
    if "tau_pert1" not in logged.columns:
        return np.zeros((len(logged.column("time")), 2))
    return np.stack([logged.column("tau_pert1"), logged.column("tau_pert2")], axis=1)


def true_windows(clock: Array, torque: Array) -> list[Span]:
    """When a torque `[N]` pushes with more than `STRONG`, s."""
    inside = np.abs(torque) > EDGE * STRONG
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    spans = []
    for a, b in edges.reshape(-1, 2):
        size = np.abs(torque[a:b])
        if size.max() > STRONG:
            strong = a + np.flatnonzero(size > EDGE * size.max())
            spans.append((float(clock[strong[0]]), float(clock[strong[-1]])))
    return spans


def found_windows(report: Report, joint: str) -> list[tuple[Span, float]]:
    """Windows of the pulses that a report places at a joint, s, and their torques, N m."""
    out = []
    for finding in report.findings:
        if finding.effect == "external_pulse" and finding.where["name"] == joint:
            out += [((float(a), float(b)), finding.parameters["f"].value) for a, b in finding.when or ()]
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


def score(report: Report, clock: Array, torque: Array) -> PulseScore:
    """Compare the pulses of a report with the pushes.

    Args:
        report: of the diagnosis.
        clock: `[N]` s.
        torque: `[N, 2]` of the pushes, N m.
    """
    overlaps, false, guess = [], 0, np.zeros_like(torque)
    for j, joint in enumerate(dfki.JOINTS):
        found = found_windows(report, joint)
        true = true_windows(clock, torque[:, j])
        overlaps += [max((overlap(span, window) for window, _ in found), default=0.0) for span in true]
        false += sum(not any(overlap(span, window) > 0 for span in true) for window, _ in found)
        for (a, b), f in found:
            guess[(clock >= a) & (clock < b), j] += abs(f)
    label = np.abs(torque) > EDGE * STRONG
    area = auc(guess.ravel(), label.ravel()) if label.any() else None
    return PulseScore([round(o, 3) for o in overlaps], false, area)


def check(diagnoses: Mapping[str, Diagnosed]) -> Outcome:
    """Every push is found at its joint, and nothing else is taken for one."""
    scores, passed = {}, True
    for name, diagnosed in diagnoses.items():
        (logged,) = diagnosed.tables
        scores[name] = got = score(diagnosed.report, logged.column("time"), pushes(logged))
        passed &= got.false == 0 and (name not in PUSHED or min(got.overlaps) >= OVERLAP)
        passed &= got.auc is None or got.auc >= AUC
    return Outcome(
        "; ".join(f"{name}: IoU {s.overlaps}, AUC {s.auc}, false {s.false}" for name, s in scores.items()),
        bool(passed),
        {name: asdict(s) | {"diagnosis_s": diagnoses[name].seconds} for name, s in scores.items()},
    )


GATE = Gate(
    name="R1",
    title="double pendulum, pushes",
    required="external_pulse at the right joint, windows IoU ≥ 0.7 for every push above 0.2 N m, AUC ≥ 0.97; "
    "none undisturbed",
    simulator=dfki.simulator,
    data={
        **{name: DataSplit([dfki.run_file(run, name, "tau_con")], [UNDISTURBED]) for name, run in PUSHED.items()},
        "undisturbed": DataSplit([UNDISTURBED]),
    },
    check=check,
)
"""The known input is what was commanded; the pushes and the measured torques are hidden."""
