"""A gate of corrected simulators against the owners' models."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from keycld_control.benchmarks.real.gate import GateResult, Outcome
from keycld_control.benchmarks.real.owners.versus import OwnersRig, Versus, versus
from keycld_envs.progress import progress


@dataclass(frozen=True)
class OwnersGate:
    """Mechanisms in turn.

    Attributes:
        name: "G7".
        title: of the gate.
        required: what must be shown, in words.
        rigs: that are diagnosed and compared.
        check: what was reached, of all rigs.
    """

    name: str
    title: str
    required: str
    rigs: Sequence[OwnersRig]
    check: Callable[[Sequence[Versus]], Outcome]

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
            error, outcome = failure, Outcome(f"could not run: {failure}", False)
        table = [
            {"rig": one.name, "owners_model": one.model, "diagnosis_s": one.seconds, "ratio": c.ratio, **asdict(c)}
            for one in found
            for c in one.compared
        ]
        return GateResult(
            self.name,
            self.title,
            self.required,
            outcome.reached,
            outcome.passed,
            {**outcome.numbers, "table": table},
            round(time.perf_counter() - start, 1),
            {one.name: one.report for one in found},
            error=error,
        )
