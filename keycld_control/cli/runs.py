"""List trainings with their scores."""

from dataclasses import asdict, dataclass
from pathlib import Path

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """List the trainings below a folder, finished or not, with their scores.

    Attributes:
        folder: Where runs of `keycld train` and `keycld delan train` lie.
        json: Print one JSON object.
    """

    folder: Positional[Path] = Path("runs")
    json: bool = False


def run(args: Args) -> None:
    """Find and print."""
    from keycld_control.runs.found import find_runs

    runs = find_runs(args.folder)
    if args.json:
        print_result({"runs": [asdict(run) for run in runs]}, as_json=True)
        return

    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE)
    for column in ("run", "of", "preset", "seed", "step", "minutes", "VPT", "torque error"):
        if column in ("run", "of", "preset"):
            table.add_column(column, overflow="fold")
        else:
            table.add_column(column, justify="right", no_wrap=True)
    for found in runs:
        table.add_row(
            str(found.folder),
            found.of.removeprefix("KeyCLD/"),
            found.preset,
            "–" if found.seed is None else str(found.seed),
            ("–" if found.step is None else f"{found.step:,}") + ("" if found.finished else ", unfinished"),
            "–" if found.seconds is None else f"{found.seconds / 60:.1f}",
            "–" if found.validation_vpt is None else f"{found.validation_vpt:.3f}",
            "–" if found.validation_error is None else f"{found.validation_error:.3g}",
        )
    Console().print(table)
