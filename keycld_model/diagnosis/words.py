"""Words and numbers for people."""

import json
from dataclasses import fields
from math import floor, isfinite, log10

from keycld_envs.effects import Effect
from keycld_model.diagnosis.report import Estimate, Finding, FitErrors

_NAMES = {
    "coulomb_friction": "Coulomb friction",
    "stribeck_friction": "Stribeck friction",
    "unknown": "Unknown physics",
}


def effect_name(effect: str) -> str:
    """Of an id: "Coulomb friction"."""
    return _NAMES.get(effect, effect.replace("_", " ").capitalize())


def call(effect: Effect) -> str:
    """Python that makes an effect: `CoulombFriction("elbow", c=0.0503)`."""
    numbers = [f"{f.name}={getattr(effect, f.name):.5g}" for f in fields(effect) if f.name != "where"]
    return f"{type(effect).__name__}({', '.join([json.dumps(effect.where), *numbers])})"


def unit(text: str) -> str:
    """As printed: "N m s/rad" is "N·m·s/rad", "1" is nothing."""
    return "" if text == "1" else text.replace(" ", "·").replace("^2", "²").replace("of·the·", "of the ")


def decimals(spread: float) -> int:
    """Digits after the point that a number with this uncertainty has: two of it if it begins with 1, else one."""
    if not (isfinite(spread) and spread > 0):
        return 4
    exponent = floor(log10(spread))
    return max(0, (1 if spread / 10.0**exponent < 1.95 else 0) - exponent)


def measured(estimate: Estimate) -> str:
    """A number, its 90 % interval and its unit: "0.0503 ± 0.0008 N·m"."""
    spread = (estimate.high - estimate.low) / 2
    digits = decimals(spread)
    middle = abs(estimate.high + estimate.low - 2 * estimate.value) <= 0.2 * (estimate.high - estimate.low)
    interval = f"± {spread:.{digits}f}"
    if not middle:
        interval = f"({estimate.low:.{digits}f} to {estimate.high:.{digits}f})"
    return " ".join(x for x in (f"{estimate.value:.{digits}f}", interval, unit(estimate.unit)) if x)


def error(value: float) -> str:
    """An error with three digits."""
    if not value or not isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(0, 2 - floor(log10(abs(value))))}f}"


def place(finding: Finding) -> str:
    """Where: "the elbow", "gravity"."""
    kind, name = finding.where["kind"], finding.where["name"]
    return {"world": "the surroundings", "sensor": "the sensor", "camera": "the camera"}.get(kind, f"the {name}")


def headline(verdict: str, findings: list[Finding], errors: FitErrors, unit: str, message: str) -> str:
    """The first sentence of a page.

    Args:
        verdict: of a report.
        findings: of the report.
        errors: of the report.
        unit: of the errors.
        message: of what stays unexplained.
    """
    if not findings:
        if verdict == "no_mismatch" and message:
            return f"No effect of the library explains what differs. {message}"
        return "Nothing is missing. With masses, lengths and encoder zeros refitted, only noise is left."
    parts = []
    for finding in findings:
        name = effect_name(finding.effect)
        name = name[0].lower() + name[1:] if not name.startswith(("Coulomb", "Stribeck")) else name
        numbers = [(n, measured(e)) for n, e in finding.parameters.items()]
        size = f" of {numbers[0][1]}" if len(numbers) == 1 else ""
        parts.append(f"{place(finding)} has {name}{size}")
    what = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"
    lacks = "that the simulator lacks" if verdict == "mismatch" else "that the simulator may lack"
    verb = "falls" if errors.corrected < errors.refitted else "goes"
    return (
        f"{what[0].upper()}{what[1:]} {lacks}; held-out error {verb} from {error(errors.refitted)} to "
        f"{error(errors.corrected)} {unit}."
    )
