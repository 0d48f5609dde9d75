"""What the recorder of Maxon's EPOS Studio writes: settings, names, units, then samples."""

import os
from itertools import islice
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.reading import check_file
from keycld_envs.recordings.importers.csv import read_csv
from keycld_envs.recordings.importers.table import Table

HEADER = 64
"""Lines within which the units of the samples stand."""
UNITS = {"s": "s", "ms": "ms", "us": "us", "rpm": "rpm", "%": "%", "A": "A", "mA": "mA", "V": "V", "°": "deg"}
"""Of the recorder, and as `Columns` calls them."""


def is_epos(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as the recorder's do."""
    try:
        with open(check_file(path), encoding="utf-8-sig", errors="replace") as file:
            start = file.read(4096)
    except (OSError, ValueError):
        return False
    return start.startswith("Date:;") and "\nEPOS Studio Version:;" in start.replace("\r", "")


def read_epos(path: str | os.PathLike[str]) -> tuple[Table, dict[str, str]]:
    """Read what the recorder wrote.

    Args:
        path: the file.

    Returns:
        Columns "time" and one per channel, named as in the file; and the units of those that `Columns` knows.

    Raises:
        InputError: if the file cannot be read, or has no line of names and one of units.
    """
    path = Path(path)
    try:
        with open(check_file(path), encoding="utf-8-sig") as file:
            lines = [line.rstrip("\r\n") for line in islice(file, HEADER)]
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); name a file of EPOS Studio's recorder.") from error
    at = next((i for i, line in enumerate(lines) if line.split(";")[0] in ("ms", "s", "us") and i > 0), None)
    if at is None:
        raise InputError(f"{path} has no line of units, such as 'ms;rpm;%'; name a file of EPOS Studio's recorder.")
    names = ["time", *(name.strip() for name in lines[at - 1].split(";")[1:])]
    units = [unit.strip() for unit in lines[at].split(";")]
    table = read_csv(path, names, skip=at + 1)
    return table, {name: UNITS[unit] for name, unit in zip(names, units, strict=False) if unit in UNITS}
