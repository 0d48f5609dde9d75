"""Work that goes on where it was stopped: what is done already is not done again."""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from keycld_envs.files import one_writer
from keycld_envs.progress import progress
from keycld_envs.workers import each


def finish(
    function: Callable[[int], object],
    items: Sequence[int],
    done: Callable[[], Collection[int]],
    folder: Path,
    title: str = "Running",
    workers: int = 1,
    ray: str | None = None,
) -> int:
    """Do what is not done yet, and be the only one who writes to a folder meanwhile.

    Args:
        function: does one item, and writes what comes of it to the folder; picklable if there are several workers.
        items: all there is to do.
        done: those that were written; asked once nobody else writes.
        folder: created if absent.
        title: of the progress bar.
        workers: processes.
        ray: address of a Ray cluster to do it on instead.

    Returns:
        How many items were done now.

    Raises:
        InputError: if another process is writing to the folder, or a worker died.
    """
    with one_writer(folder):
        before = done()
        todo = [i for i in items if i not in before]
        with progress(title, total=len(items)) as advance:
            advance(len(items) - len(todo))
            for _ in each(function, todo, workers, ray):
                advance()
    return len(todo)
