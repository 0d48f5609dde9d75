"""The log of a training run: one JSON object per line."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from keycld_envs.files import atomic_file

NAME = "log.jsonl"


def append(folder: Path, entry: dict[str, Any]) -> None:
    """Add one line; NaN, which JSON does not know, becomes null."""
    entry = {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in entry.items()}
    with open(folder / NAME, "a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")


def rewind(folder: Path, step: int) -> None:
    """Forget what was logged after `step` (optimiser steps in all) by a run that was killed later."""
    path = folder / NAME
    if not path.exists():
        return
    kept = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            if json.loads(line)["step"] <= step:
                kept.append(line)
        except (ValueError, KeyError):
            continue
    with atomic_file(path, "w") as file:
        file.write("".join(line + "\n" for line in kept))


def entries(folder: Path) -> Iterator[dict[str, Any]]:
    """All lines that are whole; a killed writer may leave half of one."""
    path = folder / NAME
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            yield json.loads(line)
        except ValueError:
            continue
