"""The parts of the page that are words and tables, as values for its templates."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from markupsafe import Markup

from keycld_envs.effects import Effect, effect_class
from keycld_model.diagnosis.inputs.observation.joint_positions import DEVIATIONS
from keycld_model.diagnosis.inputs.observation.nuisance import FACTOR_UNIT
from keycld_model.diagnosis.output.native import native
from keycld_model.diagnosis.output.page.elements import markup
from keycld_model.diagnosis.output.page.mathml import mathml
from keycld_model.diagnosis.output.page.portrait import portrait
from keycld_model.diagnosis.output.words import call, in_sentence, measured, place, spelled_out, unit
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.diagnosis.verdict.report import Estimate, Finding, Report
from keycld_model.rigid_body.residual_force import ResidualForce

DETAILS = {
    "gain_nats": "log-likelihood gained, nats",
    "held_out_gain_nats": "log-likelihood gained on held-out recordings, nats",
    "chi_square": "mean square of whitened residuals",
    "dispersion": "dispersion factor",
    "dropped": "left out, because numbers ran away",
    "not_tried": "not tried, because the budget was spent",
    "noise": "noise of each channel, in its unit",
    "step_s": "time step, s",
}
"""Names of a report's details; of others, their keys."""
REACH = {"%": 30.0, "mrad": 50.0, "mm": 50.0, "px": 1.0, "px^2": 1.0, DEVIATIONS: 3.0}
"""How far the scale of a refitted number reaches to either side, in its unit."""
OTHER_REACH = 0.05
"""The same for other units: s, s/m, 1/m."""


@dataclass(frozen=True)
class Bar:
    """An error as a bar.

    Attributes:
        name: of the simulator, as in `FitErrors`, or "noise".
        label: the same for people.
        value: the error.
        share: of the longest bar, %.
    """

    name: str
    label: str
    value: float
    share: float


@dataclass(frozen=True)
class Errors:
    """Held-out errors.

    Attributes:
        bars: from top to bottom; none if nothing was measured.
        ceiling_fails: the residual force in place of named effects is no better than the refitted simulator, and has
            no bar.
        ceiling_diverges: its error is not even a number.
    """

    bars: list[Bar]
    ceiling_fails: bool
    ceiling_diverges: bool


@dataclass(frozen=True)
class Scale:
    """An interval on a scale; places in % of its length.

    Attributes:
        title: the interval in words.
        low: where it begins.
        width: of the interval.
        value: of the estimate, None for no dot.
        zero: where an effect would be absent, None for no mark.
        zero_label: the number there.
    """

    title: str
    low: float
    width: float
    value: float | None
    zero: float | None
    zero_label: str = ""


@dataclass(frozen=True)
class Row:
    """A number in a table.

    Attributes:
        key: in the report.
        name: for people.
        text: the number with its interval and its unit.
        scale: the same as a picture.
    """

    key: str
    name: str
    text: str
    scale: Scale


@dataclass(frozen=True)
class Card:
    """A finding.

    Attributes:
        number: with which the drawing refers to it.
        finding: of the report.
        place: in words where it is no joint, actuator or body, else "".
        rows: its parameters.
        panels: a residual force over position and over speed, as SVG.
        confidence: %.
        rivals: ids and names of effects that are not excluded.
        of_the_library: it is an effect of the library.
        when: times and regions; none for always and everywhere.
    """

    number: int
    finding: Finding
    place: str
    rows: list[Row]
    panels: list[Markup]
    confidence: float
    rivals: list[tuple[str, str]]
    of_the_library: bool
    when: list[str]


@dataclass(frozen=True)
class Block:
    """Lines of Python, and a sentence about them."""

    about: str
    lines: list[str]


def held_out_errors(report: Report, evidence: Evidence) -> Errors:
    """Held-out errors as bars, with the sensor's noise as the floor where that is known."""
    fit = report.fit
    shown = {"nominal": ("as it was", fit.nominal), "refitted": ("refitted", fit.refitted)}
    if report.verdict != "no_mismatch":
        shown["corrected"] = ("corrected", fit.corrected)
    fails = fit.ceiling is not None and not fit.ceiling <= fit.refitted
    if fit.ceiling is not None and not fails:
        shown["ceiling"] = ("residual force", fit.ceiling)
    if evidence.of_sensors:
        shown["noise"] = ("sensor noise", 1e3 * float(np.sqrt(np.mean(evidence.noise**2))))
    finite = [value for _, value in shown.values() if isfinite(value)]
    if not finite:
        return Errors([], ceiling_fails=False, ceiling_diverges=False)
    largest = max(finite) or 1.0
    bars = [Bar(n, label, x, 100 * x / largest if isfinite(x) else 100.0) for n, (label, x) in shown.items()]
    return Errors(bars, fails, fit.ceiling is not None and not isfinite(fit.ceiling))


def cards(report: Report) -> list[Card]:
    """All findings."""
    shape = report.evidence.shape if report.evidence else None
    panels = [] if shape is None else [markup(panel) for panel in portrait(shape)]
    return [_card(i + 1, f, panels if f.effect == ResidualForce.id else []) for i, f in enumerate(report.findings)]


def _card(number: int, finding: Finding, panels: list[Markup]) -> Card:
    kind, name = finding.where["kind"], finding.where["name"]
    others = zip(finding.rivals, finding.rivals_where, strict=True)
    return Card(
        number=number,
        finding=finding,
        place=place(finding) if kind in ("world", "sensor", "camera") else "",
        rows=[_parameter(finding, n, e) for n, e in finding.parameters.items()],
        panels=panels,
        confidence=100 * min(max(finding.confidence, 0.0), 1.0),
        rivals=[(r, in_sentence(r) + ("" if at["name"] == name else f" at {at['name']}")) for r, at in others],
        of_the_library=effect_class(finding.effect, kind) is not None,
        when=_when(finding),
    )


def _parameter(finding: Finding, name: str, estimate: Estimate) -> Row:
    """A number, and its interval on a scale from where the effect would be absent."""
    effect = effect_class(finding.effect, finding.where["kind"])
    known = {p.name: p for p in effect.parameters()} if effect else {}
    absent = known[name].absent if name in known and not known[name].grid else None
    low, high = min(estimate.low, estimate.value), max(estimate.high, estimate.value)
    ends = [low, high] if absent is None else [low, high, absent]
    pad = 0.06 * (max(ends) - min(ends)) or 1.0
    left, width = min(ends) - pad, max(ends) - min(ends) + 2 * pad
    at = [100 * (x - left) / width for x in (low, high, estimate.value)]
    zero = None if absent is None else 100 * (absent - left) / width
    scale = Scale(
        _interval(estimate), at[0], max(at[1] - at[0], 0.6), at[2], zero, "" if absent is None else f"{absent:g}"
    )
    return Row(name, markup(mathml(name)), measured(estimate), scale)


def _interval(estimate: Estimate) -> str:
    return f"90 % interval from {estimate.low:.4g} to {estimate.high:.4g} {estimate.unit}"


def _when(finding: Finding) -> list[str]:
    """Times and regions, in words."""
    parts = []
    if finding.when:
        parts.append(", ".join(f"{a:.2f}–{b:.2f} s" for a, b in finding.when[:8]))
    elif finding.when_by_recording:
        parts.append(f"in {len(finding.when_by_recording)} recordings, shaded in their plots")
    for signal, (low, high) in (finding.region or {}).items():
        quantity, _, joint = signal.partition(":")
        what = {"qpos": "position", "qvel": "speed"}.get(quantity, quantity)
        parts.append(f"{joint}: {what} from {minus(f'{low:.3g}')} to {minus(f'{high:.3g}')}")
    return parts


def minus(text: str) -> str:
    """A text with minus signs instead of hyphens."""
    return text.replace("-", "−")


def nuisances(report: Report) -> list[Row]:
    """What was refitted; positions are in thousandths, factors in percent."""
    rows = []
    for name, estimate in report.nuisance.items():
        shown = _shown(estimate)
        reach = REACH.get(shown.unit, OTHER_REACH)
        spread = (shown.high - shown.low) / 2
        low, high = (50 + 50 * float(np.clip(x / reach, -1, 1)) for x in (shown.value - spread, shown.value + spread))
        sign = "+" if shown.unit == "%" and shown.value > 0 else ""
        scale = Scale(_interval(shown), low, max(high - low, 1.0), None, 50.0)
        rows.append(Row(name, name.replace("_", " "), sign + measured(shown), scale))
    return rows


def nuisance_scales(report: Report) -> str:
    """How far the scales of what was refitted reach: "±30 %, ±50 mrad"."""
    units = dict.fromkeys(_shown(estimate).unit for estimate in report.nuisance.values())
    return ", ".join(f"±{REACH.get(name, OTHER_REACH):g} {unit(name)}".strip() for name in units)


def _shown(estimate: Estimate) -> Estimate:
    """A refitted number as it is shown."""
    if estimate.unit in ("rad", "m"):
        return _scaled(estimate, 1e3, 0.0, f"m{estimate.unit}")
    return _scaled(estimate, 100.0, 1.0, "%") if estimate.unit == FACTOR_UNIT else estimate


def _scaled(estimate: Estimate, factor: float, origin: float, unit: str) -> Estimate:
    """An estimate in another unit."""
    value, low, high = (factor * (x - origin) for x in (estimate.value, estimate.low, estimate.high))
    return Estimate(value, unit, low, high)


def code(evidence: Evidence, environment: str | None, corrected: str | None, compared: bool = False) -> list[Block]:
    """Python that simulates what was found."""
    moving = [e for e in evidence.effects if not e.observes and spelled_out(e)]
    blocks = []
    if environment is not None and moving:
        lines = ["import keycld_envs", _import(moving), ""]
        lines += [f"env = keycld_envs.make({json.dumps(environment)}, effects=[{', '.join(map(call, moving))}])"]
        blocks.append(
            Block("The environment with the physics that it lacks, its masses and lengths as they were.", lines)
        )
    if corrected is not None:
        load = f"model = mujoco.MjModel.from_xml_path({json.dumps(corrected)})"
        rest = [e for e in native(evidence.refitted, evidence.effects).others if e in moving]
        added = "physics that MuJoCo lacks is added step by step" if rest else "physics added" if moving else ""
        about = "The corrected simulator: masses and lengths refitted" + (", " + added if added else "") + "."
        if compared:
            about += (
                " Beside what changed, it has viscous and Coulomb friction and a constant force at every joint, for "
                "rollouts over the baseline to be right; names of what both sets have, above, are of another fit."
            )
        blocks.append(Block(about, _stepping(rest, load) if rest else ["import mujoco", "", load]))
    return blocks


def _import(effects: Sequence[Effect]) -> str:
    return f"from keycld_envs.effects import {', '.join(sorted({type(e).__name__ for e in effects}))}"


def _stepping(effects: Sequence[Effect], load: str) -> list[str]:
    """Lines that load a model and add effects to its steps."""
    physics = f"physics = AddedPhysics([{', '.join(map(call, effects))}], model)"
    return [
        "import mujoco", _import(effects), "from keycld_envs.effects.added_physics import AddedPhysics", "", load,
        "data = mujoco.MjData(model)", physics, "physics.reset()", "data.ctrl[:] = 0.0",
        "for _ in physics.steps(data, 1):", "    mujoco.mj_step(model, data)",
    ]  # fmt: skip


def details(report: Report) -> list[tuple[str, str]]:
    """The fits' numbers by name."""
    named = {DETAILS.get(key, key.replace("_", " ")): value for key, value in report.details.items()}
    items = {"held out": ", ".join(report.held_out), **named, "schema": report.schema}
    return [(name, text) for name, value in items.items() if (text := _plain(value))]


def _plain(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
