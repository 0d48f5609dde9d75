"""Words and numbers for people."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import floor, isfinite, log10

from keycld_envs.effects import Effect, ExternalPulse, phrase
from keycld_model.diagnosis.verdict.report import Estimate, Experiment, Finding, FitErrors, Unexplained, Verdict
from keycld_model.rigid_body.residual_force import ResidualForce

MUCH_BEYOND = 0.25
"""Share of the time beyond the range of a baseline that a headline mentions."""
PRINTED = {"standard deviations": "σ", "^2": "²", " ": "·", "of·the·": "of the ", "·or·": " or "}
"""What units of reports are for people, in this order."""
FINEST = 1e-4
"""Of a number, beyond which no digits are written, however narrow its interval."""


def effect_name(effect: str) -> str:
    """Name of an effect's id by itself: "Coulomb friction"."""
    name = in_sentence(effect).removeprefix("a ").removeprefix("an ")
    return name[0].upper() + name[1:]


def call(effect: Effect) -> str:
    """Python that makes an effect: `CoulombFriction("elbow", c=0.0503)`; "..." for what is no number."""
    values = [(f.name, getattr(effect, f.name)) for f in fields(effect) if f.name != "where"]
    numbers = [f"{name}={value:.5g}" if isinstance(value, int | float) else f"{name}=..." for name, value in values]
    return f"{type(effect).__name__}({', '.join([json.dumps(effect.where), *numbers])})"


def spelled_out(effect: Effect) -> bool:
    """Whether `call` holds all of an effect; it does not hold a fitted function."""
    return all(isinstance(getattr(effect, f.name), int | float | str) for f in fields(effect))


def unit(text: str) -> str:
    """A unit as it is printed: "N m s/rad" is "N·m·s/rad", "1" is nothing."""
    for written, printed in PRINTED.items():
        text = text.replace(written, printed)
    return "" if text == "1" else text


def decimals(spread: float) -> int:
    """Digits after the point that a number with this uncertainty has: two of it if it begins with 1, else one."""
    if not (isfinite(spread) and spread > 0):
        return 4
    exponent = floor(log10(spread))
    return max(0, (1 if spread / 10.0**exponent < 1.95 else 0) - exponent)


def measured(estimate: Estimate) -> str:
    """A number, its 90 % interval and its unit: "0.0503 ± 0.0008 N·m"."""
    spread = (estimate.high - estimate.low) / 2
    digits = decimals(max(spread, FINEST * abs(estimate.value)))
    middle = abs(estimate.high + estimate.low - 2 * estimate.value) <= 0.2 * (estimate.high - estimate.low)
    interval = f"± {spread:.{digits}f}"
    if not middle:
        interval = f"({estimate.low:z.{digits}f} to {estimate.high:z.{digits}f})"
    return " ".join(x for x in (f"{estimate.value:z.{digits}f}", interval, unit(estimate.unit)) if x)


def error(value: float) -> str:
    """An error with three digits."""
    if not value or not isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(0, 2 - floor(log10(abs(value))))}f}"


def in_sentence(effect: str) -> str:
    """Name of an effect's id inside a sentence: "Coulomb friction", "a spring"."""
    return ResidualForce.phrase if effect == ResidualForce.id else phrase(effect)


def place(finding: Finding) -> str:
    """Where a finding is: "the elbow", "joint hinge_1", "the surroundings"."""
    kind, name = finding.where["kind"], finding.where["name"]
    if kind in ("world", "sensor", "camera"):
        return "the surroundings" if kind == "world" else f"the {kind}"
    word = kind == "joint" and name.isalpha() and len(name) > 2
    return f"the {name}" if word else f"{kind} {name}"


def experiment(proposed: Experiment) -> str:
    """What to record next, a sentence or two."""
    others = " and ".join(map(rival, proposed.against))
    if not proposed.decisive:
        return (
            f"No motion that was tried out in simulation would tell these findings from {others}: positions of these "
            "joints hardly can. Measure something else, such as the motor's current, or accept either."
        )
    what = proposed.action.replace("it ", f"{proposed.where['kind']} {proposed.where['name']} ", 1)
    start = ", ".join(f"{name} {value:.3g}" for name, value in proposed.start.items())
    return (
        f"To tell these findings from {others}, {what}, starting at rest at {start}. Their log-likelihoods are "
        f"expected to differ by {proposed.nats:.0f} nats; 10 are clear."
    )


def rival(text: str) -> str:
    """A rival as a report names it, for people: "a spring at elbow"."""
    name, at, where = text.partition(" at ")
    return f"{in_sentence(name)}{at}{where}" if name != "nothing" else name


def headline(
    verdict: Verdict,
    findings: Sequence[Finding],
    errors: FitErrors,
    unexplained: Unexplained,
    far_off: Sequence[str] = (),
) -> str:
    """What was found, in one sentence, and in another one what the simulator was told wrongly.

    Args:
        verdict: of a report.
        findings: of the report.
        errors: of the report.
        unexplained: of the report.
        far_off: refitted masses, lengths and zeros that are off by more than is expected of any mechanism, in words.
    """
    odd = " and ".join([", ".join(far_off[:-1]), far_off[-1]] if len(far_off) > 1 else far_off)
    told = f" For that, {odd}: check the simulator, the units and the clocks." if odd else ""
    if not findings:
        if unexplained.significant:
            return f"No effect of the library explains what differs. {unexplained.message}{told}"
        return f"Nothing is missing. With masses, lengths and encoder zeros refitted, only noise is left.{told}"
    what = _few(findings) if len(findings) < 3 else _many(findings)
    lacks = "lacks" if verdict == "mismatch" else "may lack"
    what = f"{what} that the simulator {lacks}" if len(findings) < 3 else f"The simulator {lacks} {what}"
    verb = "falls" if errors.corrected < errors.refitted else "goes"
    before = f"As it was handed in, the simulator does better, {error(errors.nominal)} {errors.unit}"
    astray = f" {before}: the fit has gone astray." if errors.nominal < errors.corrected else ""
    return (
        f"{what[0].upper()}{what[1:]}; held-out error {verb} from {error(errors.refitted)} to "
        f"{error(errors.corrected)} {errors.unit}.{astray}{told}"
    )


def changed_headline(
    verdict: Verdict,
    findings: Sequence[Finding],
    errors: FitErrors,
    runs: int,
    perhaps: str | None = None,
    seen: Mapping[str, str] | None = None,
    not_tried: Sequence[str] = (),
    still: Sequence[str] = (),
    several: bool = True,
    beyond: Mapping[str, float] | None = None,
) -> str:
    """What changed since a baseline, in one sentence.

    Args:
        verdict: of a report.
        findings: of the report.
        errors: of the report.
        runs: of the baseline.
        perhaps: an effect at its place that may have changed, where too little speaks for it.
        seen: dry friction that would have been found, by joint, with its unit, where nothing changed.
        not_tried: what there was no time for.
        still: joints that hardly move in the new recordings.
        several: there is more than one new recording.
        beyond: shares of the time in which new recordings leave the range of the baseline, by channel.
    """
    if not findings:
        if perhaps is not None:
            return (
                f"Perhaps something has changed, and {perhaps} is the first guess, but the {runs} runs of the baseline "
                "differ too much among themselves to be sure; more of them would tell."
            )
        if not_tried:
            return f"Nothing was found in the time that was given, and {' and '.join(not_tried)} were not looked for."
        if verdict == "undetermined":
            what = "Some of the new recordings differ" if several else "Parts of the new recording differ"
            return f"{what} from the baseline, and others do not, or not in the same way."
        sizes = " or ".join(f"{size} at {joint}" for joint, size in (seen or {}).items())
        untold = f" Nothing is told of {' and '.join(still)}, which hardly moves in them." if still else ""
        would = f" Of dry friction, {sizes} more would have been found." if seen else ""
        share, channel = max(((s, c) for c, s in (beyond or {}).items()), default=(0.0, ""))
        if share > MUCH_BEYOND:
            untold += (
                f" For {100 * share:.0f} % of the time, the {channel} is beyond the baseline's, and nothing is told."
            )
        return (
            f"Nothing has changed: the recordings differ no more than the {runs} runs of the baseline among themselves."
            f"{would}{untold}"
        )
    pushes = [f for f in findings if f.effect == ExternalPulse.id]
    what = _few(findings) if len(findings) < 3 else _many(findings)
    if len(pushes) == len(findings):
        times = sum(len(spans) for f in pushes for spans in (f.when_by_recording or {}).values())
        where = " and ".join(place(f) for f in pushes)
        often = "once" if times == 1 else f"{times} times"
        return f"Somebody or something pushed {often} in the new recordings, at {where}; nothing else has changed."
    since = "that the baseline has not" if verdict == "mismatch" else "that the baseline may not have"
    verb = "falls" if errors.corrected < errors.refitted else "goes"
    return (
        f"{what[0].upper()}{what[1:]} {since}; held-out error {verb} from {error(errors.refitted)} to "
        f"{error(errors.corrected)} {errors.unit}."
    )


def _few(findings: Sequence[Finding]) -> str:
    parts = []
    for finding in findings:
        estimates = list(finding.parameters.values())
        size = f" of {measured(estimates[0])}" if len(estimates) == 1 else ""
        verb = "have" if finding.where["kind"] == "world" else "has"
        parts.append(f"{place(finding)} {verb} {in_sentence(finding.effect)}{size}")
    return ", and ".join(parts)


def _many(findings: Sequence[Finding]) -> str:
    parts = [in_sentence(f.effect) + ("" if f.where["kind"] == "world" else f" at {place(f)}") for f in findings[:4]]
    rest = len(findings) - len(parts)
    last = f"{rest} more" if rest else parts.pop()
    return f"{', '.join(parts)}, and {last}"
