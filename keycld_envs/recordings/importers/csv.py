"""Text tables: CSV with commas, semicolons or tabs, or columns parted by spaces."""

import csv
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.table import Table

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
"""Cells, in lower case, that mark a missing sample."""
DELIMITERS = ",;\t"


def read_csv(
    path: str | os.PathLike[str], names: Sequence[str] | None = None, *, drop_truncated_end: bool = False
) -> Table:
    """Read a table of numbers from a text file.

    The delimiter is the first of comma, semicolon and tab that the first line holds, otherwise spaces. Lines that are
    empty or begin with # are skipped. A byte order mark and spaces around cells do not matter.

    Args:
        path: the file.
        names: of the columns, for a file without a header; by default the first line names them.
        drop_truncated_end: leave out a last line with too few cells, as a killed logger leaves it.

    Returns:
        All columns; cells that are empty or NaN are NaN.

    Raises:
        InputError: if the file cannot be read, a line has too few or too many cells, or a cell is no number; the
            message names file, column and line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a CSV file.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as UTF-8 text ({error}); name a CSV file.") from error
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"{path} is empty; name a file with a header and rows of numbers.")
    rows = list(_cells(lines))
    if names is None:
        _, names = rows.pop(0)
        if any(_number(name) is not None for name in names):
            raise InputError(f"{path}, line {lines[0][0]}: the header holds numbers; name the columns, --columns.")
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise InputError(f"{path}: two columns are named {twice[0]!r}; name each column once.")
    if rows and drop_truncated_end and len(rows[-1][1]) < len(names):
        rows.pop()
    if not rows:
        raise InputError(f"{path} has a header but no rows; name a file with rows of numbers.")
    values = np.array([_row(path, line, cells, names) for line, cells in rows])
    return Table(path, {name: values[:, j].copy() for j, name in enumerate(names)}, tuple(line for line, _ in rows))


def _cells(lines: list[tuple[int, str]]) -> Iterator[tuple[int, list[str]]]:
    """Line numbers, and the cells of each line."""
    delimiter = next((d for d in DELIMITERS if d in lines[0][1]), None)
    if delimiter is None:
        yield from ((i, line.split()) for i, line in lines)
        return
    parsed = csv.reader((line for _, line in lines), delimiter=delimiter, skipinitialspace=True)
    yield from ((i, [cell.strip() for cell in cells]) for (i, _), cells in zip(lines, parsed, strict=False))


def _row(path: Path, line: int, cells: list[str], names: Sequence[str]) -> list[float]:
    if len(cells) != len(names):
        what = "is truncated" if len(cells) < len(names) else "is too long"
        raise InputError(
            f"{path}, line {line} {what}: it has {len(cells)} of {len(names)} cells; repair or remove the line."
        )
    out = []
    for name, cell in zip(names, cells, strict=True):
        if (value := _number(cell)) is None:
            raise InputError(
                f"{path}, line {line}, column {name!r}: {cell!r} is no number; correct it, or leave it empty."
            )
        out.append(value)
    return out


def _number(cell: str) -> float | None:
    if cell.lower() in MISSING:
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        return None
