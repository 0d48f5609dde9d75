"""Programs of others that show trainings: TensorBoard, Weights & Biases, Trackio."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from keycld_envs.optional import optional
from keycld_model import WorldModel
from keycld_model.training.folder import TRACKED

Program = Literal["tensorboard", "wandb", "trackio"]
PROJECT = "keycld"
Write = Callable[[int, Mapping[str, float]], None]


class Tracker:
    """Sends every number of the log to a program."""

    def __init__(self, write: Write) -> None:
        """Use `write(step, numbers by name)`."""
        self._write = write

    def logged(self, entry: Mapping[str, Any]) -> None:
        """Send the entry, with its stage in front of the names of its losses."""
        stage = entry.get("stage")
        numbers = {
            name if stage is None or name in ("seconds", "validation_vpt") else f"{stage}/{name}": value
            for name, value in entry.items()
            if name != "step" and isinstance(value, int | float)
        }
        self._write(entry["step"], numbers)

    def saved(self, model: WorldModel | None, *, finished: bool) -> None:
        """Nothing to do: checkpoints stay where they are."""


@contextmanager
def tracker(program: Program, folder: Path, about: Mapping[str, Any]) -> Iterator[Tracker]:
    """Open a run in a program, and close it after the block.

    Args:
        program: which; TensorBoard's files lie in `folder/tensorboard`, the others are told where by their own settings
            (WANDB_MODE, TRACKIO_DIR, ...).
        folder: of the run, whose name is the run's.
        about: settings of the run.

    Raises:
        InputError: if the program's package is not installed.
    """
    if program == "tensorboard":
        writer = optional("tensorboardX", "tensorboard", "Logs for TensorBoard").SummaryWriter(str(folder / TRACKED))
        with writer:
            yield Tracker(lambda step, numbers: _add_all(writer, step, numbers))
        return
    module = optional(program, program, f"Logs for {program}")
    run = module.init(project=PROJECT, name=folder.name, config=dict(about))
    try:
        yield Tracker(lambda step, numbers: run.log(dict(numbers), step=step))
    finally:
        run.finish()


def _add_all(writer: Any, step: int, numbers: Mapping[str, float]) -> None:
    for name, value in numbers.items():
        writer.add_scalar(name, value, step)
    writer.flush()
