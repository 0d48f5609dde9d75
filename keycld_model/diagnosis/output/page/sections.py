"""The parts of the page that are words and tables, as HTML."""

from html import escape

import mujoco
import numpy as np

from keycld_envs.effects import Effect, effect_class
from keycld_model.diagnosis.observation.nuisance import FACTOR_UNIT
from keycld_model.diagnosis.output.native import native
from keycld_model.diagnosis.output.page.geometry import HINGE
from keycld_model.diagnosis.output.page.mathml import mathml
from keycld_model.diagnosis.output.page.portrait import portrait
from keycld_model.diagnosis.output.words import (
    call,
    effect_name,
    error,
    experiment,
    in_sentence,
    measured,
    place,
    spelled_out,
)
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.diagnosis.verdict.report import Estimate, Finding, Report


def error_bars(report: Report, evidence: Evidence) -> str:
    """Held-out errors as bars, with the sensor's noise as the floor."""
    fit, floor = report.fit, 1e3 * float(np.sqrt(np.mean(evidence.noise**2)))
    rows = [
        ("as it was", "nominal", fit.nominal),
        ("refitted", "refitted", fit.refitted),
        ("corrected", "corrected", fit.corrected),
        ("black box", "ceiling", fit.ceiling),
    ]
    shown = [(label, css, value) for label, css, value in rows if value is not None]
    if report.verdict == "no_mismatch":
        shown = [row for row in shown if row[1] != "corrected"]
    largest = max([floor, *(value for *_, value in shown)]) or 1.0
    out = []
    for label, css, value in shown:
        share = 100 * value / largest
        out.append(
            f'<div class="bar"><span class="what">{label}</span><span class="track"><span class="fill {css}" '
            f'style="width:{share:.2f}%"></span></span><span class="much">{error(value)}</span></div>'
        )
    out.append(
        f'<div class="bar"><span class="what">sensor noise</span><span class="track"><span class="fill noise" '
        f'style="width:{100 * floor / largest:.2f}%"></span></span><span class="much">{error(floor)}</span></div>'
    )
    caption = f"{report.fit.metric[:1].upper()}{report.fit.metric[1:]}, {report.fit.unit}."
    return f'{"".join(out)}<p class="caption">{escape(caption)}</p>'


def following(report: Report) -> str:
    """What to record next."""
    if report.next_experiment is None:
        return ""
    said = escape(experiment(report.next_experiment))
    return f'<section id="next"><h2>What to record next</h2><p class="lead">{said}</p></section>'


def findings(report: Report) -> str:
    """A card for each."""
    if not report.findings:
        return (
            '<p class="lead">No effect of the library pays for its numbers. What differs between the simulator and '
            "the recordings, its refitted masses, lengths and encoder zeros explain.</p>"
            if not report.unexplained.significant
            else '<p class="lead">No effect of the library explains what differs.</p>'
        )
    shape = report.evidence.shape if report.evidence else None
    return "".join(
        _card(i + 1, f, portrait(shape) if shape is not None and f.effect == "unknown" else "")
        for i, f in enumerate(report.findings)
    )


def _card(number: int, finding: Finding, picture: str = "") -> str:
    kind, name = finding.where["kind"], finding.where["name"]
    where = place(finding) if kind in ("world", "sensor", "camera") else f"{kind} <b>{escape(name)}</b>"
    rows = "".join(_parameter(finding, n, e) for n, e in finding.parameters.items())
    others = zip(finding.rivals, finding.rivals_where, strict=True)
    rivals = ", ".join(escape(in_sentence(r) + ("" if at["name"] == name else f" at {at['name']}")) for r, at in others)
    none = "No other effect" if effect_class(finding.effect, kind) else "No effect of the library"
    rivals = f"These data do not exclude {rivals}." if rivals else f"{none} explains these data as well."
    equation = f'<p class="law">{mathml(finding.equation)}</p>' if finding.equation else ""
    share = 100 * min(max(finding.confidence, 0.0), 1.0)
    sure = "&gt; 99 %" if share > 99 else f"{share:.0f} %"
    return (
        f'<article class="card"><header><span class="number">{number}</span><h3>{escape(effect_name(finding.effect))}'
        f'</h3><span class="where">{where}</span></header>{equation}'
        f'<table class="numbers"><tbody>{rows}</tbody></table>{picture}'
        f'<dl><dt>Confidence</dt><dd><span class="meter" role="img" aria-label="confidence {share:.0f} percent">'
        f'<span style="width:{share:.1f}%"></span></span> {sure}</dd><dt>Rivals</dt><dd>{rivals}</dd>'
        f"<dt>When</dt><dd>{_when(finding)}</dd></dl></article>"
    )


def _parameter(finding: Finding, name: str, estimate: Estimate) -> str:
    """A number, and its interval on a scale from where the effect would be absent."""
    effect = effect_class(finding.effect, finding.where["kind"])
    known = {p.name: p for p in effect.parameters()} if effect else {}
    absent = known[name].absent if name in known and not known[name].grid else None
    low, high = min(estimate.low, estimate.value), max(estimate.high, estimate.value)
    ends = [low, high] if absent is None else [low, high, absent]
    pad = 0.06 * (max(ends) - min(ends)) or 1.0
    left, width = min(ends) - pad, max(ends) - min(ends) + 2 * pad
    at = [100 * (x - left) / width for x in (low, high, estimate.value)]
    zero = ""
    if absent is not None:
        zero = f'<i class="zero" data-at="{absent:g}" style="left:{100 * (absent - left) / width:.2f}%"></i>'
    text = f"90 % interval from {estimate.low:.4g} to {estimate.high:.4g} {estimate.unit}"
    bar = (
        f'<span class="interval" role="img" aria-label="{escape(text)}" title="{escape(text)}">{zero}'
        f'<i class="span" style="left:{at[0]:.2f}%;width:{max(at[1] - at[0], 0.6):.2f}%"></i>'
        f'<i class="dot" style="left:{at[2]:.2f}%"></i></span>'
    )
    return _row(mathml(name), measured(estimate), bar)


def _row(name: str, text: str, bar: str) -> str:
    shown = escape(text.replace("-", "−"))
    return f'<tr><th scope="row">{name}</th><td>{shown}</td><td class="wide">{bar}</td></tr>'


def _when(finding: Finding) -> str:
    parts = []
    if finding.when:
        parts.append(", ".join(f"{a:.2f}–{b:.2f} s" for a, b in finding.when[:8]))
    elif by_recording := getattr(finding, "when_by_recording", None):
        parts.append(f"in {len(by_recording)} recordings, shaded in their plots")
    for signal, (low, high) in (finding.region or {}).items():
        quantity, _, joint = signal.partition(":")
        what = {"qpos": "position", "qvel": "speed"}.get(quantity, quantity)
        parts.append(f"{escape(joint)}: {what} from {low:.3g} to {high:.3g}".replace("-", "−"))
    return "; ".join(parts) or "throughout"


def nuisances(report: Report, model: mujoco.MjModel) -> str:
    """What was refitted, as a table."""
    kinds = {model.joint(j).name: model.jnt_type[j] == HINGE for j in range(model.njnt)}
    rows = []
    for name, estimate in report.nuisance.items():
        kind, _, of = name.partition(" of ")
        if kind == "zero":
            shown = Estimate(1e3 * estimate.value, "1", 1e3 * estimate.low, 1e3 * estimate.high)
            text = f"{measured(shown)} {'mrad' if kinds.get(of, True) else 'mm'}"
            middle, spread = estimate.value / 0.05, (estimate.high - estimate.low) / 0.1
        elif estimate.unit != FACTOR_UNIT:
            text, middle = measured(estimate), estimate.value / 0.05
            spread = (estimate.high - estimate.low) / 0.1
        else:
            percent = Estimate(100 * (estimate.value - 1), "%", 100 * (estimate.low - 1), 100 * (estimate.high - 1))
            text = ("+" if percent.value > 0 else "") + measured(percent)
            middle, spread = percent.value / 30, (percent.high - percent.low) / 60
        left, right = (50 + 50 * float(np.clip(x, -1, 1)) for x in (middle - spread, middle + spread))
        bar = f'<i class="span" style="left:{left:.1f}%;width:{max(right - left, 1):.1f}%"></i>'
        zero = '<i class="zero" style="left:50%"></i>'
        rows.append(_row(escape(name.replace("_", " ")), text, f'<span class="interval">{zero}{bar}</span>'))
    return f'<table class="numbers">{"".join(rows)}</table>'


def code(evidence: Evidence, environment: str | None, corrected: str | None) -> str:
    """Python that simulates what was found."""
    moving = [e for e in evidence.effects if not e.observes and spelled_out(e)]
    blocks = []
    if environment is not None and moving:
        names = ", ".join(sorted({type(e).__name__ for e in moving}))
        lines = ["import gymnasium as gym", "import keycld_envs", f"from keycld_envs.effects import {names}", ""]
        lines += [f'env = gym.make("{environment}", effects=[{", ".join(map(call, moving))}])']
        blocks.append(("The environment with the physics that it lacks, its masses and lengths as they were.", lines))
    if corrected is not None:
        lines = ["import mujoco", "", f'model = mujoco.MjModel.from_xml_path("{corrected}")']
        rest = [e for e in native(evidence.refitted, evidence.effects).others if e in moving]
        what = f"The corrected simulator: masses and lengths refitted{', physics added' if moving else ''}."
        if rest:
            what = (
                "The corrected simulator: masses and lengths refitted; physics that MuJoCo lacks is added step by step."
            )
            lines = [*_stepping(rest, lines)]
        blocks.append((what, lines))
    functions = [e for e in evidence.effects if not spelled_out(e)]
    missing = (
        "<p>Not in these lines: what has no name is a fitted function, in <code>report.evidence.effects</code> of "
        "<code>keycld_model.diagnosis.diagnose</code>.</p>"
    )
    return (missing if functions else "") + "".join(
        f'<p>{escape(text)}</p><div class="code"><button type="button">Copy</button><pre><code>'
        f"{escape(chr(10).join(lines))}</code></pre></div>"
        for text, lines in blocks
    )


def _stepping(effects: list[Effect], lines: list[str]) -> list[str]:
    names = ", ".join(sorted({type(e).__name__ for e in effects}))
    imports = [f"from keycld_envs.effects import {names}", "from keycld_envs.effects.added_physics import AddedPhysics"]
    physics = f"physics = AddedPhysics([{', '.join(map(call, effects))}], model)"
    return [
        lines[0], *imports, "", lines[2], "data = mujoco.MjData(model)", physics, "physics.reset()",
        "data.ctrl[:] = 0.0", "for _ in physics.steps(data, 1):", "    mujoco.mj_step(model, data)",
    ]  # fmt: skip
