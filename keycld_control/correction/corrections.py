"""From what a diagnosis found to what an agent can make up for."""

from typing import Any

from keycld_envs.effects import Effect
from keycld_envs.effects.stored import effects_from_json
from keycld_envs.errors import InputError
from keycld_model.added_effects import TAKEN


def corrections_of(report: Any, source: str) -> tuple[tuple[Effect, ...], list[str]]:
    """Effects of a diagnosis' report that a world model can be given, and names of the other findings.

    Args:
        report: `keycld_model.diagnosis.Report.to_dict()`, or report.json.
        source: its file, for errors.

    Raises:
        InputError: if it is no report of a diagnosis.
    """
    findings = report.get("findings") if isinstance(report, dict) else None
    if not isinstance(findings, list) or not all(isinstance(finding, dict) for finding in findings):
        raise InputError(f"{source} has no findings; name the report.json of `keycld diagnose --out`.")
    known = [kind.id for kind in TAKEN]
    taken = [finding for finding in findings if finding.get("effect") in known]
    left = [f"{f.get('effect')} at {_place(f.get('where'))}" for f in findings if f.get("effect") not in known]
    return effects_from_json(taken, f"{source}: findings"), left


def _place(where: Any) -> Any:
    """The name of a finding's place, as far as there is one."""
    return where.get("name") if isinstance(where, dict) else where
