"""The folder of a training run."""

import os
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_model.checkpoint import STATE, WEIGHTS
from keycld_model.training import log

TRACKED = "tensorboard"
"""Files of TensorBoard, which are there before training starts."""


def check_run_folder(folder: str | os.PathLike[str]) -> None:
    """Refuse a folder that holds anything else, before it is written to.

    Args:
        folder: absent, empty, or of a run that is to go on.

    Raises:
        InputError: if it is a file, or what it holds was not made by a training.
    """
    folder = Path(folder)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise InputError(f"{folder} is a file; name a folder.")
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    begun = STATE in names or (names & {TRACKED, log.NAME} and WEIGHTS not in names)
    if names and not begun:
        raise InputError(f"{folder} exists and was not made by a training; choose another folder.")
