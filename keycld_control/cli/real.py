"""Run the diagnosis on real recordings of other people, and compare with what it must show."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result
from keycld_control.plain_json import write_json


@dataclass(frozen=True)
class Args:
    """Run the gates on real recordings: gate, what is required, what is reached.

    The exit code is 0 if all gates that ran are reached, otherwise 1.

    Attributes:
        data: Folder with the data sets; docs/real-data.md says where to get them.
        only: Gates to run, parted by commas, for instance R3,R4; by default all.
        out: Folder for a JSON file and a page with plots per gate.
        json: Print one JSON object.
    """

    data: Positional[Path]
    only: str = ""
    out: Path | None = None
    json: bool = False


def run(args: Args) -> int:
    """Run gates, write results, print a table."""
    keep_compiled()
    from keycld_control.benchmarks.real import GATES
    from keycld_envs.errors import InputError
    from keycld_envs.progress import progress

    names = [name.strip().upper() for name in args.only.split(",") if name.strip()] or list(GATES)
    if unknown := [name for name in names if name not in GATES]:
        raise InputError(f"--only names {unknown[0]!r}; there are {', '.join(GATES)}.")
    if not args.data.is_dir():
        raise InputError(f"{args.data} is no folder; docs/real-data.md says where to get the data sets.")
    results = []
    try:
        with progress("Gates", len(names)) as advance:
            for name in names:
                advance(0, name)
                result = GATES[name](args.data)
                results.append(result)
                if args.out is not None:
                    from keycld_control.benchmarks.real.plots import write_page

                    args.out.mkdir(parents=True, exist_ok=True)
                    write_json(args.out / f"{name}.json", result.to_dict())
                    if result.curves:
                        write_page(result, args.out / f"{name}.html")
                advance(1)
    finally:  # a gate that cannot run does not take the others with it
        if args.json and len(results) == len(names):
            print_result({"gates": [result.to_dict() for result in results]}, as_json=True)
        elif results and not args.json:
            _print_table(results)
    return 0 if all(result.passed for result in results) else 1


def _print_table(results: list) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table("gate", "required", "reached", "", "s", box=box.SIMPLE)
    for result in results:
        done = "yes" if result.passed else "no"
        table.add_row(result.gate, result.required, result.reached, done, f"{result.seconds:.0f}")
    Console().print(table)
