"""The whole page."""

import json
import re
from html import escape
from importlib import resources
from math import isfinite
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_model.diagnosis.output.page.drawing import draw
from keycld_model.diagnosis.output.page.labels import Mark
from keycld_model.diagnosis.output.page.plots import plot_data
from keycld_model.diagnosis.output.page.sections import code, error_bars, findings, following, nuisances
from keycld_model.diagnosis.output.words import effect_name, headline, measured
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.diagnosis.verdict.report import Report

VERDICTS = {"no_mismatch": "nothing missing", "mismatch": "physics missing", "undetermined": "undetermined"}


def write_page(report: Report, path: Path, environment: str | None = None, corrected: str | None = None) -> None:
    """Write a report as one HTML file, which appears complete or not at all.

    Args:
        report: of `diagnose`.
        path: the file.
        environment: id of the environment that was diagnosed, for the code that uses the findings.
        corrected: name of the corrected MJCF file, for the same.

    Raises:
        InputError: if the report does not hold its evidence.
    """
    page = html_page(report, environment, corrected)
    with atomic_file(path, "w") as file:
        file.write(page)


def html_page(report: Report, environment: str | None = None, corrected: str | None = None) -> str:
    """The text of the file; see `write_page`."""
    if report.evidence is None:
        raise InputError("The report holds no evidence, so there is nothing to draw; hand in what diagnose returned.")
    evidence, model = report.evidence, report.evidence.nominal
    said = headline(
        report.verdict,
        report.findings,
        report.fit,
        report.fit.unit,
        report.unexplained.message if report.unexplained.significant else "",
    )
    left = report.unexplained
    return Template(_file("template.html")).substitute(
        title=escape(said.split(";")[0].rstrip(".")),
        description=escape(report.headline),
        headline=_unbroken(escape(said)),
        verdict=VERDICTS[report.verdict],
        css=report.verdict,
        drawing=_drawing(report, evidence),
        errors=error_bars(report, evidence),
        findings=findings(report),
        unexplained=f'<p class="{"warn" if left.significant else "lead"}">{escape(left.message)}{_share(report)}</p>',
        following=following(report),
        nuisances=nuisances(report, model),
        code=code(evidence, environment, corrected),
        details=_details(report),
        style=_file("style.css"),
        script=_file("page.js"),
        plotly=get_plotlyjs() if evidence.rollouts else "",
        data=_json(plot_data(report, evidence)),
        report=_json(report.to_dict()),
    )


def _unbroken(text: str) -> str:
    """With numbers, intervals and units on one line each."""
    return re.sub(r"(?<=\d) (?=±|[a-zA-Z]*[·/]|rad|mrad|mm|kg|of the|s\b)|(?<=±) ", "&nbsp;", text)


def _drawing(report: Report, evidence: Evidence) -> str:
    marks = [
        Mark(
            i + 1,
            finding.where["kind"],
            finding.where["name"],
            effect_name(finding.effect),
            ", ".join(measured(e) for e in finding.parameters.values()) if len(finding.parameters) == 1 else "",
        )
        for i, finding in enumerate(report.findings)
    ]
    if not evidence.rollouts:
        return draw(evidence.nominal, np.zeros(1), np.asarray(evidence.nominal.qpos0)[None], marks)
    longest = max(evidence.rollouts, key=lambda r: float(np.nanmax(np.ptp(r.measured, axis=0), initial=0.0)))
    return draw(evidence.refitted, longest.time, longest.measured, marks)


def _share(report: Report) -> str:
    left = report.unexplained
    if not (left.significant and left.fraction > 0):
        return ""
    return f" That is {100 * left.fraction:.0f} % of what the refitted simulator leaves."


def _details(report: Report) -> str:
    """The fits' numbers, as terms and definitions."""
    items: dict[str, Any] = {"held out": ", ".join(report.held_out), **report.details, "schema": report.schema}
    return "".join(f"<dt>{escape(k.replace('_', ' '))}</dt><dd>{escape(_plain(v))}</dd>" for k, v in items.items())


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _json(value: Any) -> str:
    """For a script element, which no string inside can close."""
    text = json.dumps(_finite(value), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _finite(value: Any) -> Any:
    """With null for numbers that JSON does not have."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def _file(name: str) -> str:
    return resources.files(__package__ or "").joinpath(name).read_text(encoding="utf-8")
