"""R1: pushes at a double pendulum, which nobody tells the diagnosis about."""

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.real import dfki
from keycld_control.benchmarks.real.gate import Array, GateResult, timed_diagnosis
from keycld_model.diagnosis.verdict.report import Report

PUSHED = {
    "acrobot": "acrobot/real_hardware_perturbed_v2/src_data/ilqr_tvlqr_lqr/experiment01",
    "pendubot": "pendubot/real_hardware_perturbed_v2/src_data/ilqr_tvlqr_lqr/experiment01",
}
QUIET = "acrobot/real_hardware_v2/src_data/ilqr_tvlqr_lqr/experiment01"
STRONG = 0.2
"""N m: pushes that must be found."""
EDGE = 0.1
"""Share of a push's greatest torque at which its window begins and ends."""
REQUIRED = (
    "external_pulse at the right joint, windows IoU ≥ 0.7 for every push above 0.2 N m, AUC ≥ 0.97; none undisturbed"
)
Span = tuple[float, float]


def true_windows(time_: Array, torque: Array) -> list[Span]:
    """When a torque `[N]` pushes with more than `STRONG`, s."""
    inside = np.abs(torque) > EDGE * STRONG
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    spans = []
    for a, b in edges.reshape(-1, 2):
        size = np.abs(torque[a:b])
        if size.max() > STRONG:
            strong = a + np.flatnonzero(size > EDGE * size.max())
            spans.append((float(time_[strong[0]]), float(time_[strong[-1]])))
    return spans


def found_windows(report: Report, joint: str) -> list[tuple[Span, float]]:
    """Windows of the pushes that a report places at a joint, and their torque, N m."""
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


def score(report: Report, clock: Array, torque: Array) -> dict[str, object]:
    """Overlap with every true push, false ones, and area under the curve of samples of both joints.

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
    return {"overlaps": [round(o, 3) for o in overlaps], "false": false, "auc": area}


def run(folder: Path) -> GateResult:
    """Run the gate: the known input is what was commanded, the pushes and the measured torques are hidden."""
    start, model = time.perf_counter(), dfki.simulator()
    logged = {name: dfki.table(folder, run) for name, run in {**PUSHED, "undisturbed": QUIET}.items()}
    quiet = dfki.recording(logged["undisturbed"], "undisturbed", "tau_con")
    reports, numbers, passed = {}, {}, True
    for name, table in logged.items():
        recordings = [dfki.recording(table, name, "tau_con")]
        reports[name], seconds = timed_diagnosis(recordings, model, [quiet] if name in PUSHED else [])
        got = score(reports[name], table.column("time"), dfki.pushes(table))
        numbers[name] = got | {"diagnosis_s": seconds}
        overlaps, area = got["overlaps"], got["auc"]
        assert isinstance(overlaps, list)
        passed &= got["false"] == 0 and (name not in PUSHED or min(overlaps) >= 0.7)
        passed &= area is None or (isinstance(area, float) and area >= 0.97)
    return GateResult(
        gate="R1",
        title="double pendulum, pushes",
        required=REQUIRED,
        reached="; ".join(f"{n}: IoU {s['overlaps']}, AUC {s['auc']}, false {s['false']}" for n, s in numbers.items()),
        passed=bool(passed),
        numbers=numbers,
        seconds=round(time.perf_counter() - start, 1),
        reports=reports,
    )
