"""How commands print what they found: a table for people, one JSON object for programs."""

import json
from collections.abc import Mapping
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from keycld_control.plain_json import plain, readable


def print_result(result: Mapping[str, Any], *, as_json: bool) -> None:
    """Print a result on stdout.

    Args:
        result: names and values; NumPy values are fine, NaN and infinity become null in JSON.
        as_json: print one JSON object on one line instead of a table.
    """
    if as_json:
        print(json.dumps(plain(result), ensure_ascii=False, allow_nan=False))
        return
    table = Table(box=box.SIMPLE, show_header=False)
    for name, value in result.items():
        table.add_row(name.replace("_", " "), readable(value))
    Console().print(table)
