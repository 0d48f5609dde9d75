"""List trainings with their scores."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from tyro.conf import Positional

from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from keycld_control.runs.found import Run

NOTHING = "–"
"""In cells of what is not known; a column of nothing else is left out."""
WIDEST = 24
"""Characters of a line that names the joints of a joint model, so that a terminal of 80 has room for the rest."""
WORDS = ("run", "of", "preset")
"""Columns of words; the others hold numbers."""
GAP = 2
"""Characters between columns."""


@dataclass(frozen=True)
class Args:
    """List the trainings below a folder, finished or not, with their scores.

    VPT is the mean valid prediction time on held-out recordings, fraction of the frames, of world models; error is the
    mean squared error of held-out torques, each over its variance, of joint models.

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

    rows = [_row(found) for found in runs]
    width = shutil.get_terminal_size().columns
    print("\n".join(_table(rows, width)))
    if not all(found.finished for found in runs):
        print("* unfinished")


def _table(rows: Sequence[Mapping[str, str]], width: int) -> Iterator[str]:
    """Lines of a table; where the names of runs make it too wide, each stands on a line of its own."""
    columns = [c for c in rows[0] if any(row[c] != NOTHING for row in rows)]
    widths = {c: max(len(c), *(len(line) for row in rows for line in row[c].splitlines())) for c in columns}
    apart = sum(widths.values()) + GAP * (len(columns) - 1) > width
    if apart:
        widths["run"] = 0
    for row in ({c: c for c in columns}, *rows):
        if apart:
            yield row["run"]
        cells = [[""] if apart and c == "run" else row[c].splitlines() for c in columns]
        for line in zip_longest(*cells, fillvalue=""):
            sides = [str.ljust if c in WORDS else str.rjust for c in columns]
            parts = (side(cell, widths[c]) for side, cell, c in zip(sides, line, columns, strict=True))
            yield (" " * GAP).join(parts).rstrip()


def _row(found: "Run") -> dict[str, str]:
    """Cells by column."""

    def shown(value: float | None, form: str) -> str:
        return NOTHING if value is None else format(value, form)

    return {
        "run": str(found.folder),
        "of": fill(found.of.removeprefix("KeyCLD/"), WIDEST, break_long_words=False, break_on_hyphens=False),
        "preset": found.preset,
        "seed": shown(found.seed, "d"),
        "step": shown(found.step, ",") + ("" if found.finished else "*"),
        "minutes": shown(None if found.seconds is None else found.seconds / 60, ".1f"),
        "VPT": shown(found.validation_vpt, ".3f"),
        "error": shown(found.validation_error, ".3g"),
    }
