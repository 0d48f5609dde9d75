"""Any log that an importer reads, by what the file is."""

import os
from collections.abc import Sequence
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.csv import read_csv
from keycld_envs.recordings.importers.epos import is_epos, read_epos
from keycld_envs.recordings.importers.json import read_json_log
from keycld_envs.recordings.importers.mat import read_mat
from keycld_envs.recordings.importers.mcap import read_mcap
from keycld_envs.recordings.importers.table import Table


def read_log(
    path: str | os.PathLike[str], columns: Sequence[str] | None = None, *, drop_truncated_end: bool = False
) -> tuple[Table, dict[str, str]]:
    """Read a CSV file, JSON log (.json, .jsonl), MATLAB file (.mat), MCAP file, or file of EPOS Studio's recorder.

    Args:
        path: the file.
        columns: names of the columns of a CSV file without a header.
        drop_truncated_end: leave out a last line of a CSV file that was cut short.

    Returns:
        The table, and units of columns that the file itself tells.

    Raises:
        InputError: if the file cannot be read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return read_mat(path), {}
    if suffix == ".mcap":
        return read_mcap(path), {}
    if suffix in (".json", ".jsonl"):
        return read_json_log(path), {}
    if suffix in (".xml", ".urdf"):
        raise InputError(f"{path} describes a mechanism; hand in a log, and the mechanism to `keycld new --mjcf`.")
    if is_epos(path):
        return read_epos(path)
    return read_csv(path, columns, drop_truncated_end=drop_truncated_end), {}
