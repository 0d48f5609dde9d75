"""Writing that a kill cannot damage: a path holds the old content, the whole new content, or nothing."""

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from keycld_envs.errors import InputError

LOCK = ".lock"


@contextmanager
def atomic_file(path: str | os.PathLike[str], mode: str = "wb") -> Iterator[IO[Any]]:
    """Open a file for writing that appears under `path`, complete, when the block ends without an error.

    An existing file is replaced in one step; parent folders are created. One writer at a time per path.

    Args:
        path: the file to write.
        mode: "wb", or "w" for UTF-8 text.

    Yields:
        The open temporary file beside `path`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = partial_path(path)
    try:
        with open(partial, mode, encoding=None if "b" in mode else "utf-8") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _sync(path.parent)


def check_place(path: str | os.PathLike[str]) -> None:
    """Refuse a place where a file cannot be, before long work for it.

    Raises:
        InputError: if what is above it is no folder, or may not be written to.
    """
    above = next(folder for folder in Path(path).absolute().parents if folder.exists())
    if not above.is_dir() or not os.access(above, os.W_OK):
        what = "cannot be written to" if above.is_dir() else "is no folder"
        raise InputError(f"{path} cannot be written: {above} {what}; name another place.")


@contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Fill a folder that appears under `path`, complete, when the block ends without an error.

    What a killed writer left behind is removed by the next one. One writer at a time per path.

    Args:
        path: the folder to create; it must not exist, or be empty.

    Yields:
        The temporary folder beside `path`.

    Raises:
        FileExistsError: if `path` exists and is not an empty folder.
    """
    path = Path(path)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise FileExistsError(f"{path} exists already.")
    partial = partial_path(path)
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        for entry in (*partial.rglob("*"), partial):
            _sync(entry)
        os.replace(partial, path)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    _sync(path.parent)


@contextmanager
def one_writer(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Let no other process write to a folder in the meantime; a process that is killed leaves no lock behind.

    Where the block ends with an error, what was being written in the folder, also by workers that are gone, is removed.

    Args:
        folder: created if absent.

    Raises:
        InputError: if another process is writing to it.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / LOCK, "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                raise
            raise InputError(
                f"{folder} is being written to by another process; wait until it ends, or choose another folder."
            ) from error
        try:
            yield
        except BaseException:
            for left in folder.glob(partial_path(Path("*")).name):
                shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)
            raise


def partial_path(path: Path) -> Path:
    """Where `path` is being written before it is complete: a hidden name in the same folder."""
    return path.with_name(f".{path.name}.partial")


def _sync(path: Path) -> None:
    """Flush a file or folder entry to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
