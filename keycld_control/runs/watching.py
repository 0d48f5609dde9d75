"""Who looks on while `keycld train` and `keycld delan train` train."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from keycld_control.runs.page import TrainingPage
from keycld_control.runs.trackers import Program, tracker
from keycld_envs.recordings import Dataset
from keycld_model.training.folder import check_run_folder
from keycld_model.training.watch import Watcher


@contextmanager
def watching(
    folder: Path,
    about: Mapping[str, Any],
    program: Program | None = None,
    steps: int | None = None,
    test: Callable[[], Dataset] | None = None,
) -> Iterator[Sequence[Watcher]]:
    """A page beside the run, and, if asked for, curves in another program, which are closed after the block.

    Args:
        folder: of the run.
        about: settings of the run, the title of the page.
        program: another program.
        steps: of the whole training, None if it ends by itself.
        test: recordings that are held out, of which the page shows the first; None for a joint model.

    Raises:
        InputError: if the program's package is not installed, or the folder holds anything but a run.
    """
    check_run_folder(folder)
    title = f"Training {folder.name}: " + ", ".join(f"{name} {value}" for name, value in about.items())
    page = TrainingPage(folder, title, steps, test)
    if program is None:
        yield [page]
        return
    with tracker(program, folder, about) as other:
        yield [page, other]
