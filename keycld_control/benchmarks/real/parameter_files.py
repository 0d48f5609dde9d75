"""Numbers in the owners' parameter files."""

import math
from collections.abc import Iterable
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.reading import parse_json


def numbers_of(path: Path, needed: Iterable[str]) -> dict[str, float]:
    """Numbers by name, of a JSON object or of lines "name: number" or "name = number".

    Raises:
        InputError: if the file is missing, or lacks a number.
    """
    try:
        content = path.read_text(encoding="utf-8")
        found = parse_json(content.encode()) if path.suffix == ".json" else _lines(content)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; docs/real-data.md says where to get it.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({error}); get it anew, see docs/real-data.md.") from error
    found = found if isinstance(found, dict) else {}
    numbers = {name: value for name, value in found.items() if isinstance(value, int | float) and math.isfinite(value)}
    for name in needed:
        if name not in numbers:
            raise InputError(f"{path} has no number {name!r}; get it anew, see docs/real-data.md.")
    return {name: float(value) for name, value in numbers.items()}


def _lines(content: str) -> dict[str, float]:
    """Of lines; others are skipped."""
    out = {}
    for line in content.splitlines():
        name, _, value = line.replace("=", ":", 1).partition(":")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            continue
    return out
