"""JSON of what functions return, files of it, and lines for people."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def plain(value: Any) -> Any:
    """`value` as JSON-compatible data; NumPy values are fine, NaN and infinity become null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, str | int | float | bool) else str(value)


def readable(value: Any) -> str:
    """A line of `value` for people: names with spaces, a dash for nothing, four digits, more to tell a list apart."""
    value = plain(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list) and value and all(isinstance(item, float) for item in value):
        digits = next((d for d in range(4, 9) if len({f"{x:.{d}g}" for x in value}) == len(set(value))), 9)
        return ", ".join(f"{x:.{digits}g}" for x in value)
    if isinstance(value, list):
        return ", ".join(map(readable, value))
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {readable(item)}" for key, item in value.items())
    return "–" if value is None else str(value)


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file, which appears complete or not at all."""
    from keycld_envs.files import atomic_file  # not above: this module must load where MuJoCo does not

    with atomic_file(path, "w") as file:
        json.dump(plain(value), file, ensure_ascii=False, allow_nan=False, indent=1)
        file.write("\n")
