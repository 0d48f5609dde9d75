"""A gate of effects that are concealed in somebody's recordings: what of them does a comparison find?

Which runs are a baseline, which are new, and what is concealed in these, is drawn from a seed; the truth is opened
after the diagnosis. Mechanism and sensors are real, with all that nobody modelled.
"""

import time
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from keycld_control.benchmarks.json_lines import add_line, read_lines
from keycld_control.benchmarks.real.concealing import Drawn, draw
from keycld_control.benchmarks.real.gate import GateResult, Outcome, Runs
from keycld_control.benchmarks.real.grading import REQUIRED, Case, described, passed, summary
from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_control.benchmarks.real.rivals.methods import get_method
from keycld_control.benchmarks.unfinished import finish
from keycld_envs.errors import InputError
from keycld_envs.optional import MissingPackage


@dataclass(frozen=True)
class Running:
    """How a gate of concealed effects is run.

    Attributes:
        method: that is asked what changed; see `rivals.methods`.
        cases: how many of the gate's, from the first on; None for all.
        workers: processes.
        out: folder in which finished cases are kept, and not done again; None to keep none.
    """

    method: str = "comparison"
    cases: int | None = None
    workers: int = 1
    out: Path | None = None


ALL = Running()
"""All cases by the comparison, one after another."""


@dataclass(frozen=True)
class ConcealedGate:
    """Comparisons of runs with a baseline, of several rigs in turn.

    Attributes:
        name: "G1".
        title: of the gate.
        runs: of each rig, which are compared; sizes are drawn relative to what each leaves.
        cases: how many.
        nulls: share in which nothing is concealed.
        seed: of all that is drawn.
    """

    name: str
    title: str
    runs: Sequence[Runs]
    cases: int
    nulls: float
    seed: int

    @property
    def required(self) -> str:
        """What must be shown, in words."""
        return REQUIRED

    def run(self, folder: Path, running: Running = ALL) -> GateResult:
        """The result on the data sets of a folder."""
        start, error, done = time.perf_counter(), None, {}
        numbers = range(self.cases if running.cases is None else min(running.cases, self.cases))
        with TemporaryDirectory() if running.out is None else nullcontext(running.out) as out:
            file = self.lines(Path(out), running.method)
            try:
                get_method(running.method)
                one = partial(_write, self, folder, running.method, file.resolve())
                finish(one, numbers, lambda: self.read(file), file.parent, self.name, running.workers)
            except Exception as failure:
                error = failure
            with suppress(InputError):  # which is the error then
                done = self.read(file)
        graded = [done[number] for number in numbers if number in done]
        counts = summary(graded)
        told = {"method": running.method} | counts | {"cases": graded}
        all_done = passed(counts) and len(graded) == self.cases
        outcome = Outcome.failed(error, told) if error else Outcome(described(counts), all_done, told)
        return GateResult.of(self, outcome, start, {}, error)

    def lines(self, out: Path, method: str) -> Path:
        """The file with the cases that a method has finished, one per line."""
        return out / f"{self.name}-{method.replace(' ', '-').replace(':', '.')}" / "cases.jsonl"

    def read(self, file: Path) -> dict[int, dict[str, Any]]:
        """Finished cases of a file, by number.

        Raises:
            InputError: if they were drawn otherwise.
        """
        read = read_lines(file)
        if any([case.get(key) for key in ("seed", "nulls")] != [self.seed, self.nulls] for case in read):
            raise InputError(
                f"{file} has cases of other seeds or nulls than those of the gate {self.name}, {self.seed} and "
                f"{self.nulls:g}; choose another folder for --out."
            )
        return {case["case"]: case for case in read}

    def drawn(self, number: int, folder: Path) -> Drawn:
        """A case, of the data sets of a folder."""
        return draw(self._rig(number), folder, np.random.default_rng([self.seed, number]), self.nulls)

    def case(self, number: int, folder: Path, method: str) -> Case:
        """What a method says of a case.

        Raises:
            InputError: if a file of the rig is missing or damaged, or the method needs what is not installed.
        """
        drawn = self.drawn(number, folder)
        start = time.perf_counter()
        try:
            answer = get_method(method)(drawn.new, drawn.baseline, drawn.model)
        except MissingPackage:
            raise
        except InputError as refusal:  # of recordings that do not suit the method
            answer = Answer("undetermined", failure=str(refusal))
        seconds = round(time.perf_counter() - start, 1)
        return Case(self._rig(number).name, [r.id for r in drawn.new], drawn.truth, answer, seconds)

    def _rig(self, number: int) -> Runs:
        return self.runs[number % len(self.runs)]


def _write(gate: ConcealedGate, folder: Path, method: str, file: Path, number: int) -> None:
    """Do one case, and add it to the file of those that are done."""
    case = gate.case(number, folder, method)
    told = {"case": number, "seed": gate.seed, "nulls": gate.nulls} | case.grade() | dict(case.answer.details)
    add_line(file, told)
