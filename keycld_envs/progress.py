"""One progress bar for every long command: on stderr, with the time left, silent when nobody watches."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column

RATE_OVER = 3600.0
"""s; steps of a bar may be minutes apart, and what is left is estimated from those within this time."""
CLOCK = 7
"""Characters of "0:00:00"."""


class Advance(Protocol):
    """Moves a progress bar."""

    def __call__(self, steps: int = 1, note: str | None = None) -> None:
        """Count `steps` more as done; `note` replaces the text after the bar."""
        ...


@contextmanager
def progress(title: str, total: int) -> Iterator[Advance]:
    """Show a progress bar with the estimated time left while the block runs.

    Nothing is printed when stderr is not a terminal, so that logs and pipes stay clean.

    Args:
        title: what is going on, one or two words.
        total: number of steps that make the whole.

    Yields:
        `advance(steps=1, note=None)`.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}", table_column=Column(no_wrap=True)),
        BarColumn(bar_width=16),
        MofNCompleteColumn(table_column=Column(no_wrap=True)),
        TimeElapsedColumn(Column(no_wrap=True, min_width=CLOCK)),
        TextColumn("left", table_column=Column(no_wrap=True, min_width=4)),
        TimeRemainingColumn(table_column=Column(no_wrap=True, min_width=CLOCK)),
        TextColumn("{task.fields[note]}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")),
        console=console,
        expand=True,
        speed_estimate_period=RATE_OVER,
        disable=not (sys.stderr.isatty() and console.is_interactive),  # a terminal, and none that is dumb
    )
    with bar:
        task = bar.add_task(title, total=total, note="")

        def advance(steps: int = 1, note: str | None = None) -> None:
            if note is None:
                bar.advance(task, steps)
            else:
                bar.update(task, advance=steps, note=note)

        yield advance
