"""How commands print what they found: a table for people, one JSON object for programs."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table


def print_result(result: Mapping[str, Any], *, as_json: bool) -> None:
    """Print a result on stdout.

    Args:
        result: names and values; NumPy values are fine, NaN and infinity become null in JSON.
        as_json: print one JSON object on one line instead of a table.
    """
    if as_json:
        print(json.dumps(_plain(result), ensure_ascii=False, allow_nan=False))
        return
    table = Table(box=box.SIMPLE, show_header=False)
    for name, value in result.items():
        table.add_row(name.replace("_", " "), _text(value))
    Console().print(table)


def write_result(result: Mapping[str, Any], path: Path) -> None:
    """Write a result as a JSON file, which appears complete or not at all."""
    from keycld_envs.files import atomic_file  # not above: this module must load where MuJoCo does not

    with atomic_file(path, "w") as file:
        json.dump(_plain(result), file, ensure_ascii=False, allow_nan=False, indent=1)
        file.write("\n")


def _plain(value: Any) -> Any:
    """`value` as JSON-compatible data."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, str | int | float | bool) else str(value)


def _text(value: Any) -> str:
    value = _plain(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    return "–" if value is None else str(value)
