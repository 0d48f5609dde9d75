"""Runs of trainings below a folder, and what each has reached."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from html import unescape
from pathlib import Path
from typing import Any

from keycld_control.runs.page import NAME as PAGE
from keycld_envs.errors import InputError
from keycld_envs.reading import read_json
from keycld_model.checkpoint import META, STATE
from keycld_model.training import log

HEAD = 8192
"""Characters of a page that hold its title."""


@dataclass(frozen=True)
class Run:
    """One training.

    Attributes:
        folder: of the run, below the folder that was searched.
        kind: "world model" or "joint model".
        of: environment id, name of the file that declares a mechanism alone, or names of the joints.
        preset: recipe.
        seed: of the training; None if it is not known.
        step: last step that was logged.
        finished: whether its checkpoint is there.
        validation_vpt: mean valid prediction time on held-out recordings, fraction of the frames; of world models.
        validation_error: mean squared error of held-out torques, each over its variance; of joint models.
        seconds: computing time.
        page: the page beside it, if there is one.
    """

    folder: Path
    kind: str
    of: str
    preset: str
    seed: int | None
    step: int | None
    finished: bool
    validation_vpt: float | None
    validation_error: float | None
    seconds: float | None
    page: Path | None


def find_runs(folder: Path) -> list[Run]:
    """All runs below a folder, by name.

    Raises:
        InputError: if there is no such folder or no run in it, or the description of a run is damaged.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; name one in which runs of trainings lie.")
    runs = [_run(folder, path) for path in sorted(_folders(folder))]
    if not runs:
        raise InputError(f"There is no training below {folder}; `keycld train ... --out {folder}/NAME` begins one.")
    return runs


def _folders(folder: Path) -> Iterator[Path]:
    """Of runs, finished and not."""
    found = {path.parent for path in folder.rglob(META)}
    yield from {path.parent if path.name == STATE else path for path in found}


def _run(root: Path, folder: Path) -> Run:
    finished = (folder / META).is_file()
    path = folder / META if finished else folder / STATE / META
    try:
        meta = read_json(path)
        last: dict[str, Any] = {}
        for entry in log.entries(folder):
            last |= {key: value for key, value in entry.items() if value is not None}
        joint = meta.get("joint_model")
        return Run(
            folder=folder.relative_to(root),
            kind="joint model" if joint else "world model",
            of=", ".join(joint["joints"]) if joint else meta["config"].get("system") or _declared(folder / PAGE),
            preset=joint["family"] if joint else meta["preset"],
            seed=meta.get("seed"),
            step=last.get("step", meta.get("steps")),
            finished=finished,
            validation_vpt=meta.get("validation_vpt", last.get("validation_vpt")),
            validation_error=meta.get("validation_error", last.get("validation_error")),
            seconds=meta.get("seconds", last.get("seconds")),
            page=page if (page := folder / PAGE).is_file() else None,
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({error}); remove the run or restore a copy.") from error


def _declared(page: Path) -> str:
    """The file that a mechanism was declared in, which the title of the page names."""
    if page.is_file():
        with open(page, encoding="utf-8") as file:
            title = re.search(r"<title>Training .*?: system (.*?), preset ", file.read(HEAD))
        if title:
            return Path(unescape(title[1])).name
    return "own mechanism"
