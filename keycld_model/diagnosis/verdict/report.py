"""What a diagnosis says, for programs; schema `keycld.diagnosis/1`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.replay import error_unit
from keycld_model.diagnosis.verdict.drive import Drive
from keycld_model.diagnosis.verdict.evidence import Evidence

Verdict = Literal["no_mismatch", "mismatch", "undetermined"]
BETTER = 0.95
"""Share of the error of rollouts that findings may leave at most: of 40 right changes in real recordings none left more
than .9, and one in which nothing had changed left .996 (docs/notebook/2026-11-26-noisy-commands.md)."""
SCHEMA = "keycld.diagnosis/1"
EXIT_CODES: dict[Verdict, int] = {"no_mismatch": 0, "mismatch": 10, "undetermined": 11}


@dataclass(frozen=True)
class Estimate:
    """A number with its 90 % interval."""

    value: float
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Finding:
    """One effect that the simulator lacks.

    Attributes:
        effect: id of the taxonomy, or "unknown".
        family: its family.
        where: "kind" and "name" of the place.
        parameters: by name.
        equation: in joint coordinates.
        confidence: probability that effect and place are right.
        family_confidence: probability that an effect of this family is at this place; None where only the member was
            looked for.
        rivals: ids of effects that these data do not exclude in its place; "encoder_zero" is no missing physics.
        rivals_where: their places, in the same order.
        when: seconds, None throughout.
        when_by_recording: seconds, by id of the recording, where that differs.
        region: positions and velocities to which it is confined, None if to none.
    """

    effect: str
    family: str
    where: dict[str, str]
    parameters: dict[str, Estimate]
    equation: str
    confidence: float
    rivals: list[str]
    rivals_where: list[dict[str, str]] = field(default_factory=list)
    when: list[tuple[float, float]] | None = None
    when_by_recording: dict[str, list[tuple[float, float]]] | None = None
    region: dict[str, tuple[float, float]] | None = None
    family_confidence: float | None = None

    @classmethod
    def of(
        cls,
        effect: Effect,
        parameters: Mapping[str, Estimate],
        confidence: float,
        rivals: Iterable[tuple[str, str, str]] = (),
        family_confidence: float | None = None,
        region: dict[str, tuple[float, float]] | None = None,
    ) -> "Finding":
        """The finding of an effect, with rivals by id, kind of place, and place."""
        rivals = list(rivals)
        return cls(
            effect=effect.id,
            family=effect.family,
            where={"kind": effect.kind, "name": effect.where},
            parameters=dict(parameters),
            equation=effect.equation,
            confidence=round(confidence, 4),
            rivals=[rival for rival, _, _ in rivals],
            rivals_where=[{"kind": kind, "name": name} for _, kind, name in rivals],
            region=region,
            family_confidence=None if family_confidence is None else round(family_confidence, 4),
        )


@dataclass(frozen=True)
class Unexplained:
    """What named effects and pushes leave of held-out recordings; a residual force, if there is one, is fitted to it.

    Attributes:
        significant: more than noise.
        fraction: of the misfit of the refitted simulator.
        where: joint with the largest misfit, None if none is significant.
        message: one sentence.
    """

    significant: bool
    fraction: float
    where: str | None
    message: str


@dataclass(frozen=True)
class FitErrors:
    """Root mean square errors of long rollouts on held-out recordings.

    Attributes:
        nominal: the simulator as it was.
        refitted: with masses, lengths and encoder zeros fitted.
        corrected: with the findings added.
        ceiling: a flexible black-box residual; None if it was not fitted.
    """

    metric: str
    unit: str
    nominal: float
    refitted: float
    corrected: float
    ceiling: float | None = None

    @property
    def better(self) -> bool:
        """The findings make rollouts better by more than chance does."""
        return self.corrected < BETTER * self.refitted

    @classmethod
    def of(cls, metric: str, units: tuple[str, ...], errors: Sequence[float]) -> "FitErrors":
        """Errors of channels with these units, nominal first, in thousandths."""
        return cls(metric, error_unit(units), *(round(1e3 * error, 4) for error in errors))


@dataclass(frozen=True)
class Experiment:
    """A recording that would tell apart what those at hand cannot.

    Attributes:
        where: "kind" and "name" of the joint to release, or of the actuator to drive.
        action: what to do there, a phrase.
        start: pose at rest to start from, by joint, rad or m.
        against: what is to be told from the findings: rivals, or "nothing" where perhaps nothing is missing.
        nats: expected gain in log-likelihood over the least different of them.
        decisive: that is enough; if not, even the best motion hardly tells them apart, and something else than
            positions of these joints should be measured.
        drive: what the actuator is told.
    """

    where: dict[str, str]
    action: str
    start: dict[str, float]
    against: list[str]
    nats: float
    decisive: bool
    drive: Drive = field(default_factory=Drive)


@dataclass(frozen=True)
class Report:
    """The result of `diagnose`.

    Attributes:
        verdict: "no_mismatch", "mismatch", or "undetermined".
        headline: one sentence.
        findings: what the simulator lacks.
        nuisance: refitted numbers that are no missing physics.
        unexplained: what is left after all findings.
        fit: errors on held-out recordings.
        held_out: their ids.
        next_experiment: None where nothing is left to tell apart.
        schema: of `to_dict`.
        baseline: ids of the recordings that were compared with; of a comparison, findings are what changed since.
        common: of a comparison, what both sets have that the simulator lacks; it is not the question, and less certain.
        beyond_baseline: of a comparison, share of the time in which new recordings leave the range of the baseline, by
            channel, such as "speed of elbow".
        beyond_training: the same of held-out recordings and those that were learned from. What only they excite tests
            nothing that was learned.
        details: of the fits.
        evidence: models, rollouts and residuals, for the page and the corrected model; not part of `to_dict`.
    """

    verdict: Verdict
    headline: str
    findings: list[Finding]
    nuisance: dict[str, Estimate]
    unexplained: Unexplained
    fit: FitErrors
    held_out: list[str]
    next_experiment: Experiment | None = None
    schema: str = SCHEMA
    baseline: list[str] = field(default_factory=list)
    common: list[Finding] = field(default_factory=list)
    beyond_baseline: dict[str, float] = field(default_factory=dict)
    beyond_training: dict[str, float] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    evidence: Evidence | None = field(default=None, repr=False, compare=False)

    @property
    def exit_code(self) -> int:
        """Of the command line."""
        return EXIT_CODES[self.verdict]

    def to_dict(self) -> dict[str, Any]:
        """JSON-compatible, without the evidence."""
        out = asdict(replace(self, evidence=None))
        del out["evidence"]
        return out
