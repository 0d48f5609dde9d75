"""Run the diagnosis on real recordings of other people, and compare with what it must show."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result
from keycld_control.plain_json import write_json

if TYPE_CHECKING:
    from keycld_control.benchmarks.real import AnyGate, GateResult
    from keycld_control.benchmarks.real.concealed import ConcealedGate, Running


@dataclass(frozen=True)
class Args:
    """Run the gates on real recordings: gate, what is required, what is reached.

    A gate that cannot run is no reason to leave out the others; its error comes last. The exit code is 0 if all gates
    are reached, otherwise 1, or that of the error.

    Attributes:
        data: Folder with the data sets; docs/real-data.md says where to get them.
        only: Gates to run, parted by commas, for instance G3,R4; by default all.
        gate: TOML file of a gate of your own, which is run instead.
        method: With a gate of concealed effects, such as G1: who is asked, of comparison, one set, noise, sysid, sindy,
            or your own as module:function; several, parted by commas, are shown side by side.
        cases: With such a gate: how many of its cases, from the first on; by default all.
        seed: With such a gate: which cases are drawn, in place of those of the gate.
        workers: With such a gate: number of processes.
        out: Folder for a JSON file and a page with plots per gate. Finished cases of concealed effects are kept there,
            and not run again.
        json: Print one JSON object.
    """

    data: Positional[Path]
    only: str = ""
    gate: Path | None = None
    method: str = "comparison"
    cases: int | None = None
    seed: int | None = None
    workers: int = 1
    out: Path | None = None
    json: bool = False


def run(args: Args) -> int:
    """Run gates, write results, print a table."""
    keep_compiled()
    from keycld_control.benchmarks.real import run as run_gate
    from keycld_control.benchmarks.real.concealed import ConcealedGate
    from keycld_envs.errors import InputError
    from keycld_envs.progress import progress

    chosen, running = _gates(args), _running(args)
    methods = [name.strip() for name in args.method.split(",") if name.strip()]
    if methods != ["comparison"]:
        (gate, *others) = chosen
        if others or not methods or not isinstance(gate, ConcealedGate):
            raise InputError("--method names who is asked by a gate of concealed effects; add --only G1.")
        return _side_by_side(gate, methods, running, args)
    results: list[GateResult] = []
    try:
        with progress("Gates", len(chosen)) as advance:
            for gate in chosen:
                advance(0, gate.name)
                results.append(run_gate(gate, args.data, running))
                if args.out is not None:
                    _write(results[-1], args.out)
                advance(1)
    finally:  # after Ctrl-C too
        if args.json and len(results) == len(chosen):
            print_result({"gates": [result.to_dict() for result in results]}, as_json=True)
        elif results and not args.json:
            _print_table(results)
    for result in results:
        if result.error is not None:
            raise result.error
    return 0 if all(result.passed for result in results) else 1


def _gates(args: Args) -> "list[AnyGate]":
    from keycld_control.benchmarks.real import GATES, read_gate
    from keycld_control.benchmarks.real.concealed import ConcealedGate
    from keycld_envs.errors import InputError

    names = [name.strip().upper() for name in args.only.split(",") if name.strip()] or list(GATES)
    if unknown := [name for name in names if name not in GATES]:
        raise InputError(f"--only names {unknown[0]!r}; there are {', '.join(GATES)}.")
    if args.gate is not None and args.only:
        raise InputError("--gate is one's own and --only names others; leave one of them out.")
    chosen = [GATES[name] for name in names] if args.gate is None else [read_gate(args.gate)]
    if not args.data.is_dir():
        raise InputError(f"{args.data} is no folder; docs/real-data.md says where to get the data sets.")
    if args.seed is None:
        return chosen
    if args.seed < 0:
        raise InputError(f"--seed is {args.seed}; it must not be negative.")
    if not any(isinstance(gate, ConcealedGate) for gate in chosen):
        raise InputError("--seed draws the cases of a gate of concealed effects; add --only G1.")
    return [replace(gate, seed=args.seed) if isinstance(gate, ConcealedGate) else gate for gate in chosen]


def _running(args: Args) -> "Running":
    from keycld_control.benchmarks.real.concealed import Running
    from keycld_envs.errors import InputError

    for field, number in (("--cases", args.cases), ("--workers", args.workers)):
        if number is not None and number < 1:
            raise InputError(f"{field} is {number}; it must be at least 1.")
    return Running(cases=args.cases, workers=args.workers, out=args.out)


def _side_by_side(gate: "ConcealedGate", methods: list[str], running: "Running", args: Args) -> int:
    """Ask methods, print a table; rivals need not reach anything, so that the exit code is 0 unless one ended early."""
    from keycld_control.benchmarks.real.side_by_side import HEADER, ask, rows

    results: dict[str, GateResult] = {}
    try:
        for method, result in ask(gate, args.data, methods, running):
            results[method] = result
    finally:
        if args.json and len(results) == len(methods):
            numbers = {method: result.numbers for method, result in results.items()}
            print_result({"gate": gate.name, "methods": numbers}, as_json=True)
        elif results and not args.json:
            _print(HEADER, rows(results))
    for result in results.values():
        if result.error is not None:
            raise result.error
    return 0


def _write(result: "GateResult", out: Path) -> None:
    from keycld_control.benchmarks.real.plots import write_page

    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{result.gate}.json", result.to_dict())
    if result.curves:
        write_page(result, out / f"{result.gate}.html")


def _print_table(results: "list[GateResult]") -> None:
    rows = [[r.gate, r.required, r.reached, "yes" if r.passed else "no", f"{r.seconds:.0f}"] for r in results]
    _print(("gate", "required", "reached", "", "s"), rows)


def _print(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(*header, box=box.SIMPLE)
    for row in rows:
        table.add_row(*row)
    Console().print(table)
