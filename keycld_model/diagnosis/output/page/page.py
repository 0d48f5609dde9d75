"""The whole page."""

import re
from functools import cache
from importlib import resources
from math import isfinite
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_envs.templates import templates
from keycld_model.diagnosis.output.page.drawing import draw
from keycld_model.diagnosis.output.page.elements import Element, markup
from keycld_model.diagnosis.output.page.film import film
from keycld_model.diagnosis.output.page.labels import Mark
from keycld_model.diagnosis.output.page.mathml import mathml
from keycld_model.diagnosis.output.page.plot_data import Json, plot_data
from keycld_model.diagnosis.output.page.sections import (
    cards,
    code,
    details,
    held_out_errors,
    minus,
    nuisance_scales,
    nuisances,
)
from keycld_model.diagnosis.output.page.strip import strip
from keycld_model.diagnosis.output.words import effect_name, error, experiment, measured, spelled_out
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.diagnosis.verdict.report import Report

PACKAGE = "keycld_model.diagnosis.output.page"
VERDICTS = {"no_mismatch": "nothing missing", "mismatch": "physics missing", "undetermined": "undetermined"}
CHANGED = {"no_mismatch": "nothing changed", "mismatch": "changed", "undetermined": "undetermined"}


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
    evidence = report.evidence
    return (
        _templates()
        .get_template("page.html")
        .render(
            report=report,
            verdict=(CHANGED if report.baseline else VERDICTS)[report.verdict],
            drawing=markup(_drawing(report, evidence)),
            strip=[(caption, markup(tile)) for caption, tile in strip(evidence.pictures)],
            film=film(evidence.pictures),
            evidence_recording=evidence.pictures[0].recording if evidence.pictures else "",
            images=report.details.get("images"),
            errors=held_out_errors(report, evidence),
            cards=cards(report),
            nuisances=nuisances(report),
            nuisance_scales=nuisance_scales(report),
            blocks=code(evidence, environment, corrected, bool(report.baseline)),
            functions=any(not spelled_out(e) for e in evidence.effects),
            details=details(report),
            style=_file("style.css"),
            script=_file("page.js"),
            plotly=Markup(get_plotlyjs() if evidence.rollouts else ""),
            data=_finite(plot_data(report, evidence)),
            report_json=_finite(report.to_dict()),
        )
    )


@cache
def _templates() -> jinja2.Environment:
    """The templates of the page with their filters."""
    out = templates(PACKAGE)
    out.filters |= {
        "effect_name": effect_name,
        "error": error,
        "experiment": experiment,
        "measured": measured,
        "mathml": lambda equation: markup(mathml(equation)),
        "minus": minus,
        "percent": lambda share: f"{share:.2f}%",
        "unbroken": _unbroken,
    }
    out.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "separators": (",", ":"), "allow_nan": False}
    return out


def _unbroken(text: str) -> str:
    """A text whose numbers stay on one line with their intervals and units."""
    return re.sub(r"(?<=\d) (?=±|[a-zA-Z]*[·/]|rad|mrad|mm|kg|of the|s\b)|(?<=±) ", "\N{NO-BREAK SPACE}", text)


def _drawing(report: Report, evidence: Evidence) -> Element:
    """The mechanism in a pose of the held-out recording that moves most."""
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
    longest = max(evidence.rollouts, key=lambda r: float(np.nanmax(np.ptp(r.poses[0], axis=0), initial=0.0)))
    return draw(evidence.refitted, longest.time, longest.poses[0], marks)


def _finite(value: object) -> Json:
    """A value of JSON, with null for numbers that JSON does not have."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"{value!r} is no value of JSON.")


def _file(name: str) -> Markup:
    """A file that stands in the page as it is."""
    return Markup(resources.files(PACKAGE).joinpath("templates", name).read_text(encoding="utf-8"))
