"""What importers read before it means anything: named columns of numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError

SHOWN = 40
"""Columns that a message lists."""


@dataclass(frozen=True)
class Table:
    """Named columns of numbers from a file.

    Attributes:
        path: where they come from.
        columns: each `[N]`, NaN where a sample is missing; lengths may differ in a MATLAB file.
        lines: line of the file that each row stands in; empty for files without lines.
    """

    path: Path
    columns: Mapping[str, NDArray[np.float64]]
    lines: Sequence[int] | NDArray[np.int64] = ()

    def column(self, name: str) -> NDArray[np.float64]:
        """One column.

        Raises:
            InputError: if there is none of that name.
        """
        if name not in self.columns:
            known = ", ".join(islice(self.columns, SHOWN)) + (", ..." if len(self.columns) > SHOWN else "")
            raise InputError(f"{self.path}: there is no column {name!r}; there are {known}.")
        return self.columns[name]

    def row(self, index: int) -> str:
        """Where a row stands in the file."""
        return f"line {self.lines[index]}" if len(self.lines) else f"index {index}"
