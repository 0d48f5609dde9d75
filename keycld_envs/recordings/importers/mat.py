"""MATLAB files up to version 7."""

import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import io

from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.table import Table


def read_mat(path: str | os.PathLike[str]) -> Table:
    """Read all numeric arrays of a MATLAB v5 to v7 file.

    A vector `x` becomes the column "x", a matrix, its longer side being time, "x[0]", "x[1]", ..., an entry i of a
    cell array "x{i}", a field of a structure "s.x"; indices start at zero. Scalars become columns of one row.

    Args:
        path: the file.

    Returns:
        All columns, of whatever lengths.

    Raises:
        InputError: if the file is missing, damaged, of version 7.3 (which is HDF5), or holds no numbers.
    """
    path = Path(path)
    try:
        content = io.loadmat(str(path), squeeze_me=False, struct_as_record=False, appendmat=False)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a MATLAB file.") from error
    except NotImplementedError as error:
        raise InputError(f"{path} is a MATLAB v7.3 file (HDF5); save it in MATLAB with save(..., '-v7').") from error
    except (OSError, ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, zlib.error) as error:
        raise InputError(f"{path} is damaged or no MATLAB file ({error}); replace it.") from error
    columns = {
        name: column
        for key, value in content.items()
        if not key.startswith("__")
        for name, column in _columns(key, value)
    }
    if not columns:
        raise InputError(f"{path} holds no numeric arrays; name a file with recorded signals.")
    return Table(path, columns)


def _columns(name: str, value: Any) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Names and columns of a variable."""
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _columns(f"{name}.{field}", getattr(value, field))
    elif not isinstance(value, np.ndarray):
        return
    elif value.dtype == object:
        entries = value.ravel()
        for i, entry in enumerate(entries):
            yield from _columns(name if len(entries) == 1 else f"{name}{{{i}}}", entry)
    elif value.dtype.kind in "fiub" and value.ndim == 2 and value.size:
        matrix = value.astype(np.float64)
        matrix = matrix if matrix.shape[0] >= matrix.shape[1] else matrix.T
        for j in range(matrix.shape[1]):
            yield (name if matrix.shape[1] == 1 else f"{name}[{j}]"), matrix[:, j].copy()
