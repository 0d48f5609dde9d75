"""Run the diagnosis on real recordings of other people, and compare with what it must show."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result
from keycld_control.plain_json import write_json

if TYPE_CHECKING:
    from keycld_control.benchmarks.real import GateResult


@dataclass(frozen=True)
class Args:
    """Run the gates on real recordings: gate, what is required, what is reached.

    A gate that cannot run is no reason to leave out the others; its error comes last. The exit code is 0 if all gates
    are reached, otherwise 1, or that of the error.

    Attributes:
        data: Folder with the data sets; docs/real-data.md says where to get them.
        only: Gates to run, parted by commas, for instance G3,R4; by default all.
        gate: TOML file of a gate of your own, which is run instead.
        out: Folder for a JSON file and a page with plots per gate.
        json: Print one JSON object.
    """

    data: Positional[Path]
    only: str = ""
    gate: Path | None = None
    out: Path | None = None
    json: bool = False


def run(args: Args) -> int:
    """Run gates, write results, print a table."""
    keep_compiled()
    from keycld_control.benchmarks.real import GATES, read_gate
    from keycld_control.benchmarks.real import run as run_gate
    from keycld_envs.errors import InputError
    from keycld_envs.progress import progress

    names = [name.strip().upper() for name in args.only.split(",") if name.strip()] or list(GATES)
    if unknown := [name for name in names if name not in GATES]:
        raise InputError(f"--only names {unknown[0]!r}; there are {', '.join(GATES)}.")
    if args.gate is not None and args.only:
        raise InputError("--gate is one's own and --only names others; leave one of them out.")
    chosen = [GATES[name] for name in names] if args.gate is None else [read_gate(args.gate)]
    if not args.data.is_dir():
        raise InputError(f"{args.data} is no folder; docs/real-data.md says where to get the data sets.")
    results: list[GateResult] = []
    try:
        with progress("Gates", len(chosen)) as advance:
            for gate in chosen:
                advance(0, gate.name)
                results.append(run_gate(gate, args.data))
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


def _write(result: "GateResult", out: Path) -> None:
    from keycld_control.benchmarks.real.plots import write_page

    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{result.gate}.json", result.to_dict())
    if result.curves:
        write_page(result, out / f"{result.gate}.html")


def _print_table(results: "list[GateResult]") -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table("gate", "required", "reached", "", "s", box=box.SIMPLE)
    for result in results:
        done = "yes" if result.passed else "no"
        table.add_row(result.gate, result.required, result.reached, done, f"{result.seconds:.0f}")
    Console().print(table)
