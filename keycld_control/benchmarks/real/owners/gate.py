"""A gate of corrected simulators against the owners' models."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from keycld_control.benchmarks.real.gate import GateResult, Outcome
from keycld_control.benchmarks.real.owners.versus import HORIZONS, OwnersRig, Versus, versus
from keycld_envs.progress import progress


@dataclass(frozen=True)
class OwnersGate:
    """Mechanisms in turn.

    Attributes:
        name: "G7".
        title: of the gate.
        rigs: that are diagnosed and compared.
        better: rigs on which rollouts of all lengths must be better.
        worse: how many times the owners' error any rollouts may leave.
        named: effects that must be found, of every rig.
    """

    name: str
    title: str
    rigs: Sequence[OwnersRig]
    better: int
    worse: float
    named: Sequence[str] = ()

    @property
    def required(self) -> str:
        """What must be shown, in words."""
        lengths = ", ".join(f"{s:g}" for s in HORIZONS)
        found = f"{', '.join(self.named)} named; " if self.named else ""
        best = f"better on {self.better} of {len(self.rigs)} mechanisms, " if self.better else ""
        return f"{found}held-out rollouts of {lengths} s {best}at most {self.worse:g} times the owners' error anywhere"

    def check(self, found: Sequence[Versus]) -> Outcome:
        """What was reached, of all rigs."""
        won = [one.name for one in found if all(c.ratio < 1 for c in one.compared)]
        worst = max(c.ratio for one in found for c in one.compared)
        named = [{f.effect for f in one.report.findings} for one in found]
        words = "; ".join(f"{one.name} {', '.join(f'{c.ratio:.2f}' for c in one.compared)}" for one in found)
        first = f"{', '.join(sorted(set().union(*named))) or 'nothing'} named; " if self.named else ""
        return Outcome(
            f"{first}better on {len(won)} of {len(found)}, at worst {worst:.2f} times the owners' error ({words})",
            len(won) >= self.better and worst <= self.worse and all(set(self.named) <= own for own in named),
            {"won": won},
        )

    def run(self, folder: Path) -> GateResult:
        """The result on the data sets of a folder; an error ends it and is part of the result."""
        start, error, found = time.perf_counter(), None, []
        try:
            with progress(self.name, len(self.rigs)) as advance:
                for rig in self.rigs:
                    found.append(versus(rig, folder))
                    advance(1)
            outcome = self.check(found)
        except Exception as failure:
            error, outcome = failure, Outcome.failed(failure)
        table = [
            {"rig": one.name, "owners_model": one.model, "diagnosis_s": one.seconds, "ratio": c.ratio, **asdict(c)}
            for one in found
            for c in one.compared
        ]
        outcome = replace(outcome, numbers={**outcome.numbers, "table": table})
        return GateResult.of(self, outcome, start, {one.name: one.report for one in found}, error)
