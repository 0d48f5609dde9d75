"""Whether a report says what is true."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any

from keycld_control.benchmarks.blind.make import ROLLOUT, remaining
from keycld_control.benchmarks.blind.sites import sites

Key = tuple[str, str]
"""Effect, and its joint; "*" where it has none."""
SMALL = 0.5
"""Rad or m of motion below which a spring is a constant force."""


def joint_of(system: str, where: Mapping[str, str]) -> str:
    """The joint that a place means: a joint, its motor, or the body that it moves; "*" for the world and sensors."""
    if where.get("kind") in ("world", "sensor", "camera"):
        return "*"
    field = {"actuator": "motor", "body": "body"}.get(str(where.get("kind")), "name")
    return next((s.name for s in sites(system) if getattr(s, field) == where.get("name")), str(where.get("name")))


@dataclass(frozen=True)
class CaseResult:
    """A case's answer, and what a method reported.

    Attributes:
        answer: of `answers.json`.
        output: file of the method's folder; its report is None where the method failed.
    """

    answer: Mapping[str, Any]
    output: Mapping[str, Any]

    @property
    def report(self) -> Mapping[str, Any]:
        """The report; empty if the method failed."""
        return self.output["report"] or {}

    @cached_property
    def truth(self) -> tuple[Key, ...]:
        """Effects that are missing, with their joints."""
        return tuple((t["effect"], joint_of(self.answer["system"], t["where"])) for t in self.answer["truth"])

    @cached_property
    def said(self) -> tuple[Key, ...]:
        """Effects that the report names, with their joints."""
        findings = self.report.get("findings", ())
        return tuple((f["effect"], joint_of(self.answer["system"], f["where"])) for f in findings)

    @property
    def verdict(self) -> str:
        """The verdict of the report, or "failed"."""
        return self.report.get("verdict", "failed")

    @property
    def clear(self) -> bool:
        """Whether all that is missing is clear."""
        return bool(self.answer["truth"]) and all(t["grade"] == "clear" for t in self.answer["truth"])

    @property
    def named(self) -> bool:
        """Whether all missing effects are named and no other."""
        return sorted(e for e, _ in self.said) == sorted(e for e, _ in self.truth)

    @property
    def placed(self) -> bool:
        """Whether all places are named and no other, whatever the effects are called."""
        return sorted(j for _, j in self.said) == sorted(j for _, j in self.truth)

    @property
    def right(self) -> bool:
        """Whether all missing effects are named at their places, and nothing else."""
        return sorted(self.said) == sorted(self.truth)

    @property
    def returned(self) -> list[set[Key]]:
        """The finding and its rivals, for every finding."""
        out = []
        for finding, (effect, joint) in zip(self.report.get("findings", ()), self.said, strict=True):
            others = zip_longest(finding.get("rivals", ()), finding.get("rivals_where", ()))
            rivals = {_rival(str(r), at, joint, self.answer["system"]) for r, at in others}
            out.append({(effect, joint), *rivals})
        return out

    @property
    def among_rivals(self) -> bool:
        """Whether the one effect that is missing is the one finding, or among its rivals, by name."""
        return len(self.returned) == 1 and self.truth[0][0] in {effect for effect, _ in self.returned[0]}

    @property
    def says_outside(self) -> bool:
        """Whether the report says that something is missing which no effect explains."""
        unexplained = self.report.get("unexplained", {}).get("significant", False)
        return any(e == "unknown" for e, _ in self.said) or (
            unexplained and self.verdict not in ("no_mismatch", "failed")
        )

    def error(self, name: str) -> float | None:
        """A held-out error of the report; None if it has none."""
        value = self.report.get("fit", {}).get(name)
        return None if value is None else float(value)

    @property
    def recovery(self) -> float | None:
        """(refitted - corrected)/(refitted - oracle); None without errors, or with nothing to recover.

        A case with pushes has none either: those of the held-out recordings come at times that nobody can predict.
        """
        refitted, corrected, oracle = self.error("refitted"), self.error("corrected"), self._oracle
        pushed = any(t["effect"] == "external_pulse" for t in self.answer["truth"])
        if refitted is None or corrected is None or oracle is None or pushed or refitted < 1.05 * oracle:
            return None
        return (refitted - corrected) / (refitted - oracle)

    @property
    def _oracle(self) -> float | None:
        """The error that nobody can beat; of filmed cases that of positions read off, by the method's own word."""
        known = self.answer["oracle"]["value"]
        read = self.report.get("details", {}).get("images", {}).get("error")
        if known is not None or read is None:
            return known
        return 1e3 * remaining(ROLLOUT) * math.sqrt(sum(e**2 for e in read) / len(read))

    @cached_property
    def aliases(self) -> frozenset[str]:
        """Effects that recordings like these cannot tell from the one that is missing, itself among them."""
        if self.answer["category"] != "one":
            return frozenset()
        effect, system = self.answer["truth"][0]["effect"], self.answer["system"]
        classes = []
        if len(sites(system)) == 1:  # one joint, one motor
            classes = [
                frozenset({"actuator_gain", "added_inertia", "clock_drift"}),
                frozenset({"sensor_latency", "actuator_delay"}),
            ]
        index = [s.name for s in sites(system)].index(self.answer["truth"][0]["joint"])
        if self.answer["moved"][index] < SMALL:
            classes.append(frozenset({"spring", "constant_force"}))
        return next((c for c in classes if effect in c), frozenset())


def _rival(effect: str, where: Mapping[str, str] | None, joint: str, system: str) -> Key:
    """A rival, at the same joint if no place is named."""
    if effect in ("gravity_tilt", "base_motion", "sensor_latency", "clock_drift"):
        return effect, "*"
    return effect, joint if where is None else joint_of(system, where)
