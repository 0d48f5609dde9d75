"""What a method says that changed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco

from keycld_envs.recordings import Recording
from keycld_model.diagnosis import Report
from keycld_model.diagnosis.verdict.report import Estimate, Verdict


@dataclass(frozen=True)
class Change:
    """One effect that is new.

    Attributes:
        effect: id of the taxonomy.
        where: name of the joint or motor.
        parameters: by name.
        rivals: ids of effects that the method does not exclude in its place.
    """

    effect: str
    where: str
    parameters: Mapping[str, Estimate]
    rivals: Sequence[str] = ()


@dataclass(frozen=True)
class Answer:
    """What a method says of a comparison.

    Attributes:
        verdict: "mismatch" if it says that something changed.
        changes: what, the likeliest first.
        error_falls: whether what changed lowers the error on held-out recordings; None if the method does not say.
        failure: why it says nothing.
        details: JSON-compatible.
    """

    verdict: Verdict
    changes: Sequence[Change] = ()
    error_falls: bool | None = None
    failure: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_report(cls, report: Report) -> "Answer":
        """What a diagnosis says."""
        changes = [Change(f.effect, f.where["name"], f.parameters, f.rivals) for f in report.findings]
        told = {"report": replace(report, evidence=None).to_dict()}
        return cls(report.verdict, changes, report.fit.corrected < report.fit.refitted, details=told)


Method = Callable[[Sequence[Recording], Sequence[Recording], mujoco.MjModel], Answer]
"""Of new recordings, the baseline, and the simulator."""
