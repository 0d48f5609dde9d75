"""What was right of what a method says that changed, and counts of it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import beta

from keycld_control.benchmarks.real.concealing import FIXED
from keycld_control.benchmarks.real.rivals.answer import Answer, Change
from keycld_envs.effects import Effect

REQUIRED = (
    "no alarms; named .90, in the reported set .97, placed .97; size within 20 % in .80; intervals cover .85 to .95; "
    "held-out error falls in every true case"
)

TRUE = ("named", "among", "in_set", "placed", "error_falls")
"""What is counted of cases in which something is concealed."""


@dataclass(frozen=True)
class Case:
    """One comparison, the truth, and what a method says.

    Attributes:
        rig: its name.
        new: ids of the recordings in which something is concealed.
        truth: the effect; None if nothing is.
        answer: of the method.
        seconds: that it took.
    """

    rig: str
    new: Sequence[str]
    truth: Effect | None
    answer: Answer
    seconds: float

    def grade(self) -> dict[str, Any]:
        """What was right, JSON-compatible."""
        changes = self.answer.changes
        out: dict[str, Any] = {
            "rig": self.rig,
            "new": list(self.new),
            "truth": None if self.truth is None else str(self.truth),
            "verdict": self.answer.verdict,
            "findings": [f"{c.effect} at {c.where}" for c in changes],
            "seconds": self.seconds,
            "failure": self.answer.failure,
        }
        if self.truth is None:
            return out | {"alarm": self.answer.verdict == "mismatch"}
        named = bool(changes) and _names(changes[0], self.truth)
        place = bool(changes) and _placed(changes[0], self.truth)
        sizes = _sizes(changes[0], self.truth) if named else {}
        return out | {
            "named": named,
            "among": any(_names(change, self.truth) for change in changes),
            "in_set": named or (place and self.truth.id in changes[0].rivals),
            "placed": place,
            "extra": max(0, len(changes) - 1),
            "sized": bool(sizes) and all(abs(e.value - true) < 0.2 * abs(true) for true, e in sizes.values()),
            "covered": [bool(e.low <= true <= e.high) for true, e in sizes.values()],
            "error_falls": self.answer.error_falls,
        }


def _names(change: Change, truth: Effect) -> bool:
    return _placed(change, truth) and change.effect == truth.id


def _placed(change: Change, truth: Effect) -> bool:
    return _joint(change.where) == _joint(truth.where)


def _joint(where: str) -> str:
    """Joint of a place; motors have the names of their joints in these rigs, or there is one of each."""
    return "hinge" if where == "motor" else where


def _sizes(change: Change, truth: Effect) -> dict[str, Any]:
    """True and estimated size, by the parameters that have one."""
    return {
        p.name: (getattr(truth, p.name), change.parameters[p.name])
        for p in truth.parameters()
        if p.name not in FIXED and abs(getattr(truth, p.name) - p.absent) > 0
    }


def summary(graded: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts of graded cases."""
    nulls, true = [g for g in graded if g["truth"] is None], [g for g in graded if g["truth"] is not None]
    counts = Counter({key: sum(bool(g[key]) for g in true) for key in TRUE})
    named = [g for g in true if g["named"]]
    covered = [c for g in named for c in g["covered"]]
    return {
        "nulls": len(nulls),
        "failures": sum(g["failure"] is not None for g in graded),
        "alarms": sum(g["alarm"] for g in nulls),
        "concealed": len(true),
        **counts,
        "sized": sum(g["sized"] for g in named),
        "covered": sum(covered),
        "intervals": len(covered),
        "extra": sum(g["extra"] for g in true),
        "median_s": float(np.median([g["seconds"] for g in graded])) if graded else 0.0,
        "longest_s": max((g["seconds"] for g in graded), default=0.0),
    }


def interval(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Clopper and Pearson, 1934)."""
    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(0.975, count + 1, of - count))
    return low, high


def share(count: int, of: int) -> str:
    """A count with the 95 % interval of its share."""
    low, high = interval(count, of)
    return f"{count} of {of} ({low:.2f} to {high:.2f})" if of else "0 of 0"


def described(numbers: Mapping[str, Any]) -> str:
    """Counts in words."""
    n = numbers
    return (
        f"alarms {share(n['alarms'], n['nulls'])}; named {share(n['named'], n['concealed'])}, in the reported set "
        f"{share(n['in_set'], n['concealed'])}, placed {share(n['placed'], n['concealed'])}; within 20 % "
        f"{share(n['sized'], n['named'])}; intervals cover {share(n['covered'], n['intervals'])}; held-out error falls "
        f"{share(n['error_falls'], n['concealed'])}; further findings {n['extra']}; seconds {n['median_s']:.0f}, "
        f"longest {n['longest_s']:.0f}"
    )


def passed(numbers: Mapping[str, Any]) -> bool:
    """Whether all that is required was reached."""
    n = numbers
    if n["failures"] or not (n["nulls"] and n["concealed"] and n["named"] and n["intervals"]):
        return False
    return bool(
        n["alarms"] == 0
        and n["named"] >= 0.9 * n["concealed"]
        and n["in_set"] >= 0.97 * n["concealed"]
        and n["placed"] >= 0.97 * n["concealed"]
        and n["sized"] >= 0.8 * n["named"]
        and 0.85 <= n["covered"] / n["intervals"] <= 0.95
        and n["error_falls"] == n["concealed"]
    )
