"""What a diagnosis can be expected to show; gates are declared in these words.

Each class is a table `[[expect.NAME]]` of a gate's file, and its attributes are the fields of that table.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from keycld_control.benchmarks.real import pushes
from keycld_control.benchmarks.real.fields import check_known
from keycld_control.benchmarks.real.gate import Array, Diagnosed, Expectation, Outcome, group_of
from keycld_control.benchmarks.real.replay import Observed, refit, roll, variant
from keycld_control.benchmarks.refitting import Finding as Found
from keycld_envs.effects import EFFECTS, Effect
from keycld_envs.errors import InputError

FAMILIES = {e.family: None for e in EFFECTS.values()} | {
    e.confusable.group: None for e in EFFECTS.values() if e.confusable is not None
}
"""Slots of the equations, and groups of effects that do nearly the same."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Kinds of findings, of which a gate speaks.

    Attributes:
        effect: ids of effects, any of which counts; any at all if there are none.
        family: instead, all effects of a family, such as "force", or of a group, such as "dry friction".
        at: places, any of which counts; any at all if there are none.
        of: diagnoses that are meant; all if there are none.
    """

    effect: tuple[str, ...] = ()
    family: str | None = None
    at: tuple[str, ...] = ()
    of: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError if an effect or a family is unknown."""
        for id in self.effect:
            check_known("effect", id, {e.id: None for e in EFFECTS.values()})
        if self.family is not None:
            check_known("family", self.family, FAMILIES)

    def matches(self, found: Found) -> bool:
        """Whether a finding is of this kind."""
        return (
            (not self.effect or found.effect in self.effect)
            and (self.family is None or self.family in (found.family, group_of(found)))
            and (not self.at or found.where["name"] in self.at)
        )

    def named(self) -> str:
        """In words."""
        what = self.family or " or ".join(self.effect) or "finding"
        return what + (f" at {' or '.join(self.at)}" if self.at else "")


@dataclass(frozen=True, kw_only=True)
class Finding(Kind):
    """Something is found.

    Attributes:
        between: range of each parameter, by name; those that a finding has must lie in theirs, and it must have one.
        least: findings of the kind.
        alone: nothing else is found.
        rivals: effects that must be told as not excluded, beside each finding or as the finding itself.
        confidence: least confidence in the effect.
    """

    between: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    least: int = 1
    alone: bool = False
    rivals: tuple[str, ...] = ()
    confidence: float = 0.0

    def required(self) -> str:
        """In words."""
        ranges: dict[tuple[float, float], list[str]] = {}
        for name, between in self.between.items():
            ranges.setdefault(between, []).append(name)
        sizes = [f", {'/'.join(names)} {low:.3g} to {high:.3g}" for (low, high), names in ranges.items()]
        return (
            (f"{self.least} × " if self.least > 1 else "")
            + self.named()
            + "".join(sizes)
            + (f", not excluded: {', '.join(self.rivals)}" if self.rivals else "")
            + (f", confidence ≥ {self.confidence:g}" if self.confidence else "")
            + (", nothing else" if self.alone else "")
        )

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """Enough findings are as they must be."""
        findings = diagnosed.report.findings
        right = [f for f in findings if self.matches(f) and self._sized(f) and self._doubted(f)]
        right = [f for f in right if f.confidence >= self.confidence]
        passed = len(right) >= self.least and not (self.alone and len(findings) > len(right))
        return Outcome("", passed, {"found": len(right), "findings": len(findings)})

    def _sized(self, found: Found) -> bool:
        sizes = {name: found.parameters[name].value for name in self.between if name in found.parameters}
        if not self.between:
            return True
        return bool(sizes) and all(self.between[n][0] <= v <= self.between[n][1] for n, v in sizes.items())

    def _doubted(self, found: Found) -> bool:
        return set(self.rivals) <= {found.effect, *found.rivals}


@dataclass(frozen=True, kw_only=True)
class Absent(Kind):
    """Something is not found."""

    def required(self) -> str:
        """In words."""
        return f"no {self.named()}"

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """Nothing of the kind is there."""
        wrong = [f"{f.effect} at {f.where['name']}" for f in diagnosed.report.findings if self.matches(f)]
        return Outcome("", not wrong, {"wrong": wrong})


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What is concluded.

    Attributes:
        any_of: "mismatch", "no_mismatch" or "undetermined".
        of: diagnoses that are meant; all if there are none.
    """

    any_of: tuple[str, ...]
    of: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError if there is no such verdict."""
        for verdict in self.any_of:
            check_known("any_of", verdict, ("mismatch", "no_mismatch", "undetermined"))

    def required(self) -> str:
        """In words."""
        return " or ".join(self.any_of).replace("_", " ")

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """It is one of them."""
        return Outcome(diagnosed.report.verdict.replace("_", " "), diagnosed.report.verdict in self.any_of)


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """Whether more than noise is left.

    Attributes:
        significant: it is.
        of: diagnoses that are meant; all if there are none.
    """

    significant: bool
    of: tuple[str, ...] = ()

    def required(self) -> str:
        """In words."""
        return f"{'more' if self.significant else 'no more'} than noise unexplained"

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """As it must be."""
        left = diagnosed.report.unexplained
        return Outcome(left.message, left.significant == self.significant, {"unexplained_fraction": left.fraction})


@dataclass(frozen=True, kw_only=True)
class Refitted:
    """A product of refitted masses and lengths.

    Attributes:
        name: of the product.
        product: power of each number, by its name in the report.
        times: value in the simulator; the numbers are factors to it.
        between: range in which it must lie.
        of: diagnoses that are meant; all if there are none.
    """

    name: str
    product: Mapping[str, float]
    between: tuple[float, float]
    times: float = 1.0
    of: tuple[str, ...] = ()

    def required(self) -> str:
        """In words."""
        return f"{self.name} {self.between[0]:.3g} to {self.between[1]:.3g}"

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """It lies in the range."""
        nuisance = diagnosed.report.nuisance
        for name in self.product:
            check_known("expect.refitted: product", name, dict(nuisance))
        value = self.times * math.prod(nuisance[name].value ** power for name, power in self.product.items())
        passed = self.between[0] <= value <= self.between[1]
        return Outcome(f"{self.name} = {value:.3g}", passed, {self.name: round(value, 5)})


@dataclass(frozen=True, kw_only=True)
class Error:
    """Error of rollouts on held-out recordings, beside an opponent's.

    Attributes:
        opponent: effects, each with `effect`, `at`, and parameters to start from, which are refitted to the same
            recordings; the refitted simulator if there are none.
        most: share of the opponent's error.
        seconds: of each rollout.
        of: diagnoses that are meant; all if there are none.
    """

    most: float
    seconds: float
    opponent: tuple[Mapping[str, Any], ...] = ()
    of: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError if an opponent is no effect."""
        self.effects()

    def effects(self) -> list[Effect]:
        """Of the opponent."""
        return [_effect(table) for table in self.opponent]

    def required(self) -> str:
        """In words."""
        name = " and ".join(e.id.replace("_", " ") for e in self.effects()) or "the refitted simulator"
        return f"held-out error ≤ {self.most:.2g} of {name}'s"

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """It is as small as it must be, over all held-out recordings together."""
        report, held_out, seconds = diagnosed.report, diagnosed.held_out, self.seconds
        observed = Observed.of(report, diagnosed.model)
        opponent = (
            refit(observed, self.effects(), diagnosed.training, seconds)
            if self.opponent
            else variant(report, observed, findings=False)
        )
        theirs = roll(observed, opponent, held_out, seconds)
        found = roll(observed, variant(report, observed, findings=True), held_out, seconds)
        ratio = found.error() / theirs.error()
        errors = {
            name: [round(rollouts.error(i), 2) for i in range(len(held_out))]
            for name, rollouts in {"opponent": theirs, "found": found}.items()
        }
        return Outcome(
            f"held-out error {errors['found']} of {errors['opponent']}, ratio {ratio:.3f}",
            bool(np.isfinite(ratio) and ratio <= self.most),
            {"errors": errors, "ratio": round(ratio, 3)},
        )


@dataclass(frozen=True, kw_only=True)
class Pushes:
    """Pushes that a file logs are found at their joints and times, and no others.

    Attributes:
        columns: of their torques, N m, by joint; a file without them has no pushes.
        strong: torque of those that must be found, N m.
        overlap: least intersection over union with one of them, for it to be found; any overlap by default.
        share: of them that must be found, of all recordings together.
        auc: least area under the ROC curve, over samples.
        false: most pushes that are found where there are none, per recording on average.
        of: diagnoses that are meant; all if there are none.
    """

    columns: Mapping[str, str]
    strong: float
    overlap: float = 0.0
    share: float = 1.0
    auc: float = 0.0
    false: float = 0.0
    of: tuple[str, ...] = ()

    def required(self) -> str:
        """In words."""
        return (
            f"{self.share:.0%} of pushes above {self.strong:g} N m at the right joint, IoU ≥ {self.overlap:g}, AUC ≥ "
            f"{self.auc:g}, at most {self.false:g} false ones per recording"
        )

    def check(self, diagnosed: Diagnosed) -> Outcome:
        """Each recording by itself."""
        scores = {}
        for table, recording in zip(diagnosed.tables, diagnosed.recordings, strict=True):
            clock = np.asarray(recording.t_state)
            torques: dict[str, Array] = {
                joint: table.column(name) if name in table.columns else np.zeros_like(clock)
                for joint, name in self.columns.items()
            }
            scores[recording.id] = pushes.score(diagnosed.report, recording.id, clock, torques, self.strong)
        overlaps = [o for s in scores.values() for o in s.overlaps]
        found, false = sum(o > 0 and o >= self.overlap for o in overlaps), sum(s.false for s in scores.values())
        passed = (
            found >= self.share * len(overlaps)
            and false <= self.false * len(scores)
            and all(s.auc is None or s.auc >= self.auc for s in scores.values())
        )
        told = ", ".join(f"{id}: IoU {s.overlaps}, AUC {s.auc}, false {s.false}" for id, s in scores.items())
        return Outcome(
            f"{found} of {len(overlaps)} pushes, {false} false ({told})",
            passed,
            {"found": found, "pushes": len(overlaps), "false": false} | {id: asdict(s) for id, s in scores.items()},
        )


def _effect(table: Mapping[str, Any]) -> Effect:
    """An effect with its parameters, as declared.

    Raises:
        InputError: if there is none of that name, or it lacks a place.
    """
    own = dict(table)
    id, at = str(own.pop("effect", "")), own.pop("at", None)
    kinds = {e.id: e for e in EFFECTS.values()}
    check_known("opponent: the effect", id, kinds)
    if not isinstance(at, str):
        raise InputError(f"opponent: {id} is nowhere; write at which place, at = ...")
    parameters = {p.name: None for p in kinds[id].parameters()}
    for name in own:
        check_known(f"opponent: for {id}, the parameter", name, parameters)
    return kinds[id](at, **{name: float(value) for name, value in own.items()})


EXPECTATIONS: Mapping[str, type[Expectation]] = {
    "finding": Finding,
    "absent": Absent,
    "verdict": Verdict,
    "unexplained": Unexplained,
    "refitted": Refitted,
    "error": Error,
    "pushes": Pushes,
}
"""By the name of their tables."""
