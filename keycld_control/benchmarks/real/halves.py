"""A gate of halves: do findings from one half of somebody's recordings come out of the other half, too?

Nobody knows what real mechanisms lack; but what is there is in both halves.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from keycld_control.benchmarks.real.gate import GateResult, Outcome, Runs, group_of
from keycld_control.benchmarks.real.grading import interval, share
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_model.diagnosis import Report, diagnose

AGREE = 0.9
"""Share of the confident findings that the other half must confirm."""
CONFIDENT = 0.5
"""Confidence from which a finding counts as such."""
BINS = (0.0, 0.25, CONFIDENT, 0.75, np.inf)
"""Edges of the confidences that are counted together."""
REQUIRED = (
    f"findings of confidence ≥ {CONFIDENT:g} agree in family and place in ≥ {AGREE:.0%}; of findings of confidence c, "
    "a share c is confirmed by the other half"
)


def confirmed(report: Report, other: Report) -> list[dict[str, Any]]:
    """Findings of one half, and whether the other has the same family, group of effects, or effect there."""
    out = []
    for finding in report.findings:
        there = [f for f in other.findings if f.where == finding.where]
        of_family = finding.confidence if finding.family_confidence is None else finding.family_confidence
        out.append(
            {
                "effect": finding.effect,
                "family": finding.family,
                "where": finding.where["name"],
                "confidence": finding.confidence,
                "family_confidence": of_family,
                "confirmed": any(f.family == finding.family for f in there),
                "alike": any(group_of(f) == group_of(finding) for f in there),
                "named": any(f.effect == finding.effect for f in there),
            }
        )
    return out


def calibration(found: Sequence[Mapping[str, Any]], confidence: str, right: str) -> list[dict[str, Any]]:
    """Findings counted by a confidence, with its mean, and how many of them are right."""
    out = []
    for low, high in pairwise(BINS):
        if own := [f for f in found if low <= f[confidence] < high]:
            mean = round(float(np.mean([f[confidence] for f in own])), 3)
            out.append({"confidence": mean, "findings": len(own), "right": sum(f[right] for f in own)})
    return out


def summary(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts of findings, how many the other half confirms, and whether they were as sure as that."""
    confident = [f for f in found if f["family_confidence"] >= CONFIDENT]
    return {
        "findings": len(found),
        **{key: sum(f[key] for f in found) for key in ("confirmed", "alike", "named")},
        "confident": len(confident),
        "confident_confirmed": sum(f["confirmed"] for f in confident),
        "of_family": calibration(found, "family_confidence", "confirmed"),
        "of_effect": calibration(found, "confidence", "named"),
    }


def calibrated(bins: Sequence[Mapping[str, Any]]) -> bool:
    """Whether chance explains how shares differ from confidences: 95 % intervals of the shares contain them."""
    return all(low <= b["confidence"] <= high for b in bins for low, high in [interval(b["right"], b["findings"])])


def passed(numbers: Mapping[str, Any]) -> bool:
    """Whether all that is required was reached; without a confident finding, it is not."""
    n = numbers
    agree = n["confident"] > 0 and n["confident_confirmed"] >= AGREE * n["confident"]
    return bool(agree and calibrated(n["of_family"]) and calibrated(n["of_effect"]))


def described(numbers: Mapping[str, Any]) -> str:
    """Counts in words."""
    n = numbers

    def told(bins: Sequence[Mapping[str, Any]]) -> str:
        return ", ".join(f"{share(b['right'], b['findings'])} at {b['confidence']:.2f}" for b in bins) or "none"

    words = (("confirmed", "family"), ("alike", "group"), ("named", "name"))
    agree = ", ".join(f"in {word} {share(n[key], n['findings'])}" for key, word in words)
    return (
        f"of confidence ≥ {CONFIDENT:g}, confirmed {share(n['confident_confirmed'], n['confident'])}; of all, {agree}; "
        f"by mean confidence in the family: {told(n['of_family'])}; in the effect: {told(n['of_effect'])}"
    )


@dataclass(frozen=True)
class HalvesGate:
    """Diagnoses of disjoint halves of recordings, of several rigs.

    Attributes:
        name: "G8".
        title: of the gate.
        runs: of each rig.
        splits: how often the runs of a rig are parted, at random.
        seed: of what is drawn.
        budget: seconds after which a search ends with the best it has; none if it has as long as it takes.
    """

    name: str
    title: str
    runs: Sequence[Runs]
    splits: int
    seed: int
    budget: float | None = None

    @property
    def required(self) -> str:
        """What must be shown, in words."""
        return REQUIRED

    def run(self, folder: Path) -> GateResult:
        """The result on the data sets of a folder."""
        start, error = time.perf_counter(), None
        reports: dict[str, Report] = {}
        found: list[dict[str, Any]] = []
        try:
            read = [(one.simulator(folder), [f.recording(folder) for f in one.files]) for one in self.runs]
            with progress(self.name, 2 * len(read) * self.splits) as advance:
                for number, (runs, (model, recordings)) in enumerate(zip(self.runs, read, strict=True)):
                    for split in range(self.splits):
                        halves = parted(recordings, np.random.default_rng([self.seed, number, split]))
                        both = []
                        for part, half in zip("ab", halves, strict=True):
                            both.append(replace(diagnose(half, model, budget=self.budget), evidence=None))
                            reports[f"{runs.name} {split}{part}"] = both[-1]
                            advance(1)
                        for part, own, other in (("a", both[0], both[1]), ("b", both[1], both[0])):
                            where = {"rig": runs.name, "half": f"{split}{part}", "verdict": own.verdict}
                            found += [where | f for f in confirmed(own, other)]
        except Exception as failure:
            error = failure
        numbers = summary(found)
        by_rig = {one.name: summary([f for f in found if f["rig"] == one.name]) for one in self.runs}
        told = numbers | {"rigs": by_rig, "found": found}
        outcome = Outcome.failed(error, told) if error else Outcome(described(numbers), passed(numbers), told)
        return GateResult.of(self, outcome, start, reports, error)


def parted(recordings: Sequence[Recording], rng: np.random.Generator) -> tuple[list[Recording], list[Recording]]:
    """Two halves, at random."""
    order = [recordings[i] for i in rng.permutation(len(recordings))]
    half = len(order) // 2
    return order[:half], order[half:]
