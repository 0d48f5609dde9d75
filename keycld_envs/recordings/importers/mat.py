"""MATLAB files up to version 7."""

import os
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.reading import check_file, check_size, read_limit
from keycld_envs.recordings.importers import mat_process
from keycld_envs.recordings.importers.table import Table

COMPRESSED = 15
"""Type of a compressed variable in a MATLAB v5 to v7 file."""
CHUNK = 1 << 20
ROOM = 3 << 29
"""Bytes of address space that Python, NumPy and SciPy take."""


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
        _check_content(check_file(path))
        columns = _read_apart(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a MATLAB file.") from error
    except NotImplementedError as error:
        raise InputError(f"{path} is a MATLAB v7.3 file (HDF5); save it in MATLAB with save(..., '-v7').") from error
    except (OSError, ValueError, zlib.error) as error:
        raise InputError(f"{path} is damaged or no MATLAB file ({error}); replace it.") from error
    if not columns:
        raise InputError(f"{path} holds no numeric arrays; name a file with recorded signals.")
    return Table(path, columns)


def _read_apart(path: Path) -> dict[str, NDArray[np.float64]]:
    """The columns, read by another process, which may crash.

    Raises:
        NotImplementedError: if the file is of version 7.3.
        ValueError: if it is damaged.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "columns.npz"
        memory = str(4 * read_limit() + ROOM)
        done = subprocess.run(
            [sys.executable, "-P", mat_process.__file__, str(path), str(out), memory],
            capture_output=True,
            text=True,
            errors="replace",
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            check=False,
        )
        if done.returncode == mat_process.VERSION_7_3:
            raise NotImplementedError
        if done.returncode:
            raise ValueError(" ".join(done.stdout.split()) or "it cannot be read")
        check_size(out.stat().st_size)
        with np.load(out) as arrays:
            return {str(name): arrays[f"c{i}"] for i, name in enumerate(arrays["names"])}


def _check_content(path: Path) -> None:
    """Refuse compressed content that would fill the memory.

    Raises:
        ValueError: if it would take more than the limit of `keycld_envs.reading`.
    """
    total = 0
    with open(path, "rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(128)[126:], "")
        while order and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                file.seek(size, 1)
                continue
            decoder, left = zlib.decompressobj(), size
            while left > 0 and not decoder.eof and (piece := file.read(min(left, CHUNK))):
                left -= len(piece)
                while piece:
                    total += len(decoder.decompress(piece, CHUNK))
                    check_size(total)
                    piece = decoder.unconsumed_tail
            file.seek(left, 1)
