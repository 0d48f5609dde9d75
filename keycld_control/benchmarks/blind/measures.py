"""Every row of the contract's table, for one method."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import beta, binomtest

from keycld_control.benchmarks.blind.match import CaseResult

SURE = 0.8
"""Confidence that counts as sure."""


@dataclass(frozen=True)
class Required:
    """What must be reached where it depends on what is observed.

    Attributes:
        name: share of single clear effects that are named.
        place: share that are placed.
        recovery: median of R.
        seconds: of the longest case.
    """

    name: float
    place: float
    recovery: float
    seconds: float


REQUIRED = {"states": Required(0.98, 0.99, 0.98, 60.0), "pixels": Required(0.95, 0.97, 0.95, 600.0)}


@dataclass(frozen=True)
class Measure:
    """One row of the table.

    Attributes:
        measure: in words.
        reached: the figure; None if there is nothing to measure it on.
        required: what it must reach; None where it stands for comparison.
        at_most: smaller is better.
        hits: number counted, where it is a share.
        count: of how many.
        interval: 95 % Clopper-Pearson interval of a share.
        note: whatever else is worth knowing.
    """

    measure: str
    reached: float | None
    required: float | tuple[float, float] | None = None
    at_most: bool = False
    hits: int | None = None
    count: int = 0
    interval: tuple[float, float] | None = None
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the requirement is met; None where nothing is required or measured."""
        if self.reached is None or self.required is None:
            return None
        if isinstance(self.required, tuple):
            return self.required[0] <= self.reached <= self.required[1]
        return self.reached <= self.required if self.at_most else self.reached >= self.required

    def to_dict(self) -> dict[str, Any]:
        """JSON-compatible."""
        return asdict(self) | {"met": self.met}


def share(
    measure: str,
    hits: Sequence[bool],
    required: float | tuple[float, float] | None = None,
    at_most: bool = False,
    note: str = "",
) -> Measure:
    """A share with its interval."""
    k, n = int(np.sum(hits)), len(hits)
    if not n:
        return Measure(measure, None, required, at_most, None, 0, None, note)
    interval = binomtest(k, n).proportion_ci(0.95, "exact")
    return Measure(measure, k / n, required, at_most, k, n, (float(interval.low), float(interval.high)), note)


def measures(results: Sequence[CaseResult], required: Required) -> list[Measure]:
    """All measures of a method."""
    of = {c: [t for t in results if t.answer["category"] == c] for c in ("null", "one", "two", "three", "outside")}
    one, outside = ([t for t in of[c] if t.clear] for c in ("one", "outside"))
    apart = [t for t in one if not t.aliases]
    alike = [t for t in one if t.aliases]
    return [
        _alarms(of["null"]),
        share("null: unexplained, nothing named", [_unexplained(t) for t in of["null"]]),
        share("one clear effect: name", [t.named for t in one], required.name, note="that finding and no other"),
        share("one clear effect: place", [t.placed for t in one], required.place),
        share("one clear effect: name, counting rivals", [t.among_rivals for t in one]),
        share("one clear effect: name, exact aliases left out", [t.named for t in apart], note="see indistinguishable"),
        share("one clear effect: something found", [t.verdict not in ("no_mismatch", "failed") for t in one]),
        share("two clear effects: both named and placed", [t.right for t in of["two"] if t.clear], 0.90),
        share("three clear effects: all named and placed", [t.right for t in of["three"] if t.clear], 0.75),
        *_recovery(results, outside, required),
        share("outside the library: says so", [t.says_outside for t in outside], 0.95, note="clear cases"),
        share("indistinguishable: returns the set", [t.among_rivals for t in alike], 0.95),
        _set_size(alike),
        _coverage([t for t in results if t.clear and t.right]),
        *_confidence(results),
        _worse(results),
        *_cost(results, required),
        share("failed with an error", [t.output["failure"] is not None for t in results]),
    ]


def _alarms(nulls: Sequence[CaseResult]) -> Measure:
    alarms = [t.verdict not in ("no_mismatch", "failed") or bool(t.said) for t in nulls]
    certain = sum(t.verdict == "mismatch" for t in nulls)
    k, n = sum(alarms), len(alarms)
    upper = float(beta.ppf(0.95, k + 1, n - k)) if k < n else 1.0
    return share(
        "false alarms on null cases", alarms, 0.0, True, f"{certain} of them certain; one-sided bound {upper:.3f}"
    )


def _unexplained(result: CaseResult) -> bool:
    return not result.said and bool(result.report.get("unexplained", {}).get("significant", False))


def _recovery(results: Sequence[CaseResult], outside: Sequence[CaseResult], required: Required) -> list[Measure]:
    clear = [t for t in results if t.clear and t.answer["category"] != "outside"]
    inside = [r for t in clear if (r := t.recovery) is not None]
    beyond = [r for t in outside if (r := t.recovery) is not None]
    note = f"{len(clear) - len(inside)} cases with pushes, errors, or nothing to recover left out"
    return [
        _quantile("oracle recovery R, clear effects: median", inside, 0.5, required.recovery, note),
        _quantile("oracle recovery R, clear effects: 5th percentile", inside, 0.05, 0.90, ""),
        _quantile("outside the library: R, median", beyond, 0.5, 0.8, ""),
    ]


def _quantile(measure: str, values: Sequence[float], at: float, required: float, note: str) -> Measure:
    reached = float(np.quantile(values, at)) if values else None
    return Measure(measure, reached, required, count=len(values), note=note)


def _set_size(alike: Sequence[CaseResult]) -> Measure:
    sizes = [len(t.returned[0]) for t in alike if t.returned]
    reached = float(np.mean(sizes)) if sizes else None
    return Measure("indistinguishable: mean size of the set", reached, 2.2, True, count=len(sizes))


def _coverage(results: Sequence[CaseResult]) -> Measure:
    inside = []
    for result in results:
        findings = dict(zip(result.said, result.report.get("findings", ()), strict=True))
        for key, true in zip(result.truth, result.answer["truth"], strict=True):
            estimates = findings.get(key, {}).get("parameters", {})
            inside += [
                estimates[name]["low"] <= value <= estimates[name]["high"]
                for name, value in true["comparable"].items()
                if name in estimates and estimates[name].get("low") is not None
            ]
    return share("coverage of the 90 % intervals", inside, (0.88, 0.92), note="cases in which all is named and placed")


def _confidence(results: Sequence[CaseResult]) -> list[Measure]:
    """Shares of named findings that are right, by what else the report says, and by their confidence."""
    nameless = {"unknown", "external_pulse"}
    of: dict[str, list[bool]] = {"only noise is left": [], "more is left": [], "beside pushes or unknown": []}
    sure, unsure = [], []
    for result in results:
        findings = result.report.get("findings", ())
        beside = not nameless.isdisjoint(f["effect"] for f in findings)
        left = result.report.get("unexplained", {}).get("significant", False)
        where = "beside pushes or unknown" if beside else "more is left" if left else "only noise is left"
        for key, finding in zip(result.said, findings, strict=True):
            if finding["effect"] not in nameless:
                of[where].append(key in result.truth)
                (sure if finding.get("confidence", 0.0) >= SURE else unsure).append(key in result.truth)
    return [
        *(share(f"named findings that are right: {where}", hits) for where, hits in of.items()),
        share(f"named findings that are right: confidence of {SURE} and more", sure),
        share("named findings that are right: less", unsure),
    ]


def _worse(results: Sequence[CaseResult]) -> Measure:
    pairs = [(t.error("corrected"), t.error("refitted")) for t in results]
    worse = [a > b for a, b in pairs if a is not None and b is not None]
    return share("corrected worse than refitted, held out", worse, 0.005, True)


def _cost(results: Sequence[CaseResult], required: Required) -> list[Measure]:
    wall, cpu = ([float(t.output[key]) for t in results] for key in ("wall_s", "cpu_s"))
    middle = f"median {np.median(wall):.1f} s" if wall else ""
    return [
        Measure(
            "seconds per case, longest", max(wall, default=None), required.seconds, True, count=len(wall), note=middle
        ),
        Measure("processor seconds per case, mean", float(np.mean(cpu)) if cpu else None, count=len(cpu)),
    ]
