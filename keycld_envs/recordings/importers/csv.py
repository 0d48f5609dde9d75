"""Text tables: CSV with commas, semicolons or tabs, or columns parted by spaces."""

import csv
import os
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, count
from pathlib import Path
from typing import TextIO

import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.reading import check_file
from keycld_envs.recordings.importers.table import Table

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
"""Cells, in lower case, that mark a missing sample."""
DELIMITERS = ",;\t"
LONGEST_LINE = 1 << 24
"""Characters; a longer one is no table of numbers."""


def read_csv(
    path: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    drop_truncated_end: bool = False,
    skip: int = 0,
) -> Table:
    """Read a table of numbers from a text file.

    The delimiter is the first of comma, semicolon and tab that the first line holds, otherwise spaces. Lines that are
    empty or begin with # are skipped. A byte order mark and spaces around cells do not matter.

    Args:
        path: the file.
        names: of the columns, for a file without a header; by default the first line names them.
        drop_truncated_end: leave out a last line with too few cells, as a killed logger leaves it.
        skip: lines before the table, which are anything.

    Returns:
        All columns; cells that are empty or NaN are NaN.

    Raises:
        InputError: if the file cannot be read, a line has too few or too many cells, or a cell is no number; the
            message names file, column and line.
    """
    path = Path(path)
    try:
        with open(check_file(path), encoding="utf-8-sig") as file:
            return _table(path, file, names, drop_truncated_end, skip)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a CSV file.") from error
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as UTF-8 text ({error}); name a CSV file in UTF-8.") from error


def _table(path: Path, file: TextIO, names: Sequence[str] | None, drop_truncated_end: bool, skip: int) -> Table:
    rows = _rows(file, skip)
    header = next(rows, None)
    if header is None:
        raise InputError(f"{path} is empty; name a file with a header and rows of numbers.")
    if names is None:
        line, names = header
        if any(_number(name) is not None for name in names):
            raise InputError(f"{path}, line {line}: the header holds numbers; name the columns, --columns.")
    else:
        rows = chain([header], rows)
    if len(set(names)) < len(names):
        twice = Counter(names).most_common(1)[0][0]
        raise InputError(f"{path}: two columns are named {twice!r}; name each column once.")
    values, lines = array("d"), array("q")
    row = next(rows, None)
    while row is not None:
        (line, cells), row = row, next(rows, None)
        if row is None and lines and len(cells) < len(names):
            if drop_truncated_end:
                break
            if not skip:  # tables inside other files are read without that option
                raise InputError(
                    f"{path}, line {line} is truncated: it has {len(cells)} of {len(names)} cells; remove this last "
                    "line, or have `keycld import` leave it out, --drop-truncated-end."
                )
        values.extend(_row(path, line, cells, names))
        lines.append(line)
    if not lines:
        raise InputError(f"{path} has a header but no rows; name a file with rows of numbers.")
    table = np.frombuffer(values).reshape(-1, len(names))
    return Table(path, {name: table[:, j].copy() for j, name in enumerate(names)}, np.frombuffer(lines, np.int64))


def _rows(file: TextIO, skip: int) -> Iterator[tuple[int, list[str]]]:
    """Line numbers, and the cells of each line after some that is neither empty nor a comment."""
    lines = ((i, line) for i, line in _lines(file) if i > skip and line.strip() and not line.startswith("#"))
    first = next(lines, None)
    if first is None:
        return
    delimiter = next((d for d in DELIMITERS if d in first[1]), None)
    for i, line in chain([first], lines):
        if delimiter is None:
            yield i, line.split()
        else:
            cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
            yield i, [cell.strip() for cell in cells]


def _lines(file: TextIO) -> Iterator[tuple[int, str]]:
    """Lines and their numbers.

    Raises:
        ValueError: if a line has no end.
    """
    for i in count(1):
        line = file.readline(LONGEST_LINE)
        if not line:
            return
        if len(line) == LONGEST_LINE:
            raise ValueError(f"line {i} has more than {LONGEST_LINE:,} characters")
        yield i, line


def _row(path: Path, line: int, cells: list[str], names: Sequence[str]) -> list[float]:
    if len(cells) != len(names):
        what = "is truncated" if len(cells) < len(names) else "is too long"
        raise InputError(
            f"{path}, line {line} {what}: it has {len(cells)} of {len(names)} cells; repair or remove the line."
        )
    out = []
    for name, cell in zip(names, cells, strict=True):
        if (value := _number(cell)) is None:
            point = _number(cell.replace(",", ".")) is not None
            remedy = "write it with a decimal point" if point else "correct it, or leave it empty"
            raise InputError(f"{path}, line {line}, column {name!r}: {cell!r} is no number; {remedy}.")
        out.append(value)
    return out


def _number(cell: str) -> float | None:
    if cell.lower() in MISSING:
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        return None
