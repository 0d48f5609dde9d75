"""Files with one JSON object per line, to which several processes add."""

import fcntl
import json
from pathlib import Path
from typing import Any

from keycld_control.plain_json import plain
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file


def read_lines(path: Path) -> list[dict[str, Any]]:
    """All objects of a file; none if there is no file.

    Raises:
        InputError: if a line is no JSON object.
    """
    if not path.is_file():
        return []
    out = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            value = json.loads(line)
        except ValueError:
            value = None
        if not isinstance(value, dict):
            raise InputError(f"{path}, line {number}: this is no JSON object; remove the line, or the file.")
        out.append(value)
    return out


def add_line(path: Path, value: Any) -> None:
    """Add an object; a kill leaves the file with or without it, and others who add at the same time wait."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path.with_name(f".{path.name}.lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        before = path.read_text(encoding="utf-8") if path.is_file() else ""
        with atomic_file(path, "w") as file:
            file.write(before + json.dumps(plain(value), ensure_ascii=False, allow_nan=False) + "\n")
