"""One progress bar for every long command: on stderr, with the time left, silent when nobody watches."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


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
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
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
