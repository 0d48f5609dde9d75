"""Reading files that others have written: they must be regular, of bounded size, and hold what they claim.

No file fills the memory: what would take more than a limit is refused before it is read. The limit is 0.75 GB for each
file; the environment variable `KEYCLD_READ_LIMIT` has another, in GB.
"""

import json
import math
import os
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

VARIABLE = "KEYCLD_READ_LIMIT"
DEFAULT_LIMIT = 0.75
"""GB; a process that reads as much stays below 1 GB."""
JSON_SHARE = 16
"""Objects take about so many times the memory of the JSON they come from."""
MAX_ARRAYS = 1000
"""Arrays in a file; more have no use, and their directory alone could fill the memory."""
_CHUNK = 1 << 20
_DIRECTORY_END = b"PK\x05\x06"


def read_limit() -> int:
    """Bytes that one file may take in memory.

    Raises:
        ValueError: if the environment variable `KEYCLD_READ_LIMIT` is no positive number of GB.
    """
    text = os.environ.get(VARIABLE, str(DEFAULT_LIMIT))
    try:
        limit = float(text)
    except ValueError:
        limit = math.nan
    if not 0 < limit < math.inf:
        raise ValueError(f"the environment variable {VARIABLE} is {text!r}; it must be a positive number of GB")
    return int(limit * 1e9)


def check_size(size: float, share: int = 1) -> None:
    """Refuse what would take `size` bytes.

    Raises:
        ValueError: if that is more than `read_limit() / share`.
    """
    if size * share > read_limit():
        raise ValueError(
            f"it would take {size * share / 1e9:.3g} GB of memory, more than {read_limit() / 1e9:.3g} GB; if that is "
            f"right, set the environment variable {VARIABLE} to more GB"
        )


def check_file(path: str | os.PathLike[str], share: int = 1) -> Path:
    """The path, if it is one of a regular file that may be read.

    Args:
        path: of the file.
        share: how many times the file's size reading it takes.

    Raises:
        OSError: if there is none.
        ValueError: if it is a folder, a pipe or a device, which may never end, or is too large.
    """
    status = os.stat(path)
    if stat.S_ISDIR(status.st_mode):
        raise ValueError("it is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("it is a pipe or a device, not a file")
    check_size(status.st_size, share)
    return Path(path)


def read_json(path: str | os.PathLike[str]) -> Any:
    """What a JSON file holds.

    Raises:
        OSError: if there is none.
        ValueError: if it is damaged, nested too deeply, or too large.
    """
    return parse_json(check_file(path, JSON_SHARE).read_bytes())


def parse_json(content: bytes | str) -> Any:
    """What JSON in UTF-8 says.

    Raises:
        ValueError: if it is damaged or nested too deeply.
    """
    try:
        return json.loads(content)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def read_arrays(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """The arrays of an npz file, without pickle; checksums find damaged bytes.

    Raises:
        OSError: if there is none.
        ValueError: if it is damaged or too large, or an array is not what its header claims.
    """
    path = check_file(path)
    with open(path, "rb") as file, _damage():
        _check_directory(file)
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            check_size(sum(entry.file_size for entry in entries))
            names = [entry.filename.removesuffix(".npy") for entry in entries]
            if len(set(names)) < len(names):
                raise ValueError("it holds an array twice")
            return {name: _read_array(archive, entry) for name, entry in zip(names, entries, strict=True)}


@contextmanager
def _damage() -> Iterator[None]:
    """What the standard library and NumPy raise for a damaged archive, as ValueError."""
    try:
        yield
    except (EOFError, KeyError, TypeError, AttributeError, NotImplementedError, RuntimeError, MemoryError) as error:
        raise ValueError(str(error) or "it is cut short") from error
    except (zipfile.BadZipFile, zlib.error, SyntaxError, TokenError, OverflowError) as error:
        raise ValueError(str(error)) from error


def _check_directory(file: IO[bytes]) -> None:
    """Refuse archives of too many entries, before their directory is read."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 65557))  # a comment at the end is not longer
    end = file.read()
    at = end.rfind(_DIRECTORY_END)
    if at >= 0 and int.from_bytes(end[at + 10 : at + 12], "little") > MAX_ARRAYS:
        raise ValueError(f"it holds more than {MAX_ARRAYS} arrays")
    file.seek(0)


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """One array, if its header claims as many bytes as there are."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{entry.filename} is compressed in a way that NumPy does not write")
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in read_header:
            raise ValueError(f"{entry.filename} has version {version} of NumPy's format")
        shape, columns_first, dtype = read_header[version](stream)
        claimed = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or min(shape, default=0) < 0 or claimed != entry.file_size - stream.tell():
            raise ValueError(f"{entry.filename} claims {dtype} of shape {shape}, which its bytes are not")
        array = np.empty(math.prod(shape), dtype)
        bytes_of = array.view(np.uint8) if claimed else np.empty(0, np.uint8)
        at = 0
        while at < claimed and (chunk := stream.read(min(_CHUNK, claimed - at))):
            bytes_of[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
            at += len(chunk)
        if at < claimed or stream.read(1):  # at its end, the checksum is compared
            raise ValueError(f"{entry.filename} is cut short")
    return array.reshape(shape, order="F" if columns_first else "C")
