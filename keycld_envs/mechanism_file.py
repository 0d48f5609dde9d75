"""A mechanism in a Python file of its own: what stands in it under the name `system`, or `mechanism`."""

import contextlib
import functools
import os
import runpy
import sys
from dataclasses import replace
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_envs.systems import System

SYSTEM, MECHANISM = "system", "mechanism"
"""Variables of such a file: a whole simulation, or keypoints, rods and sliders alone, for a video of one's own."""


def is_mechanism_file(name: str | os.PathLike[str]) -> bool:
    """Whether a name means a Python file rather than an environment."""
    return Path(name).suffix == ".py"


def read_mechanism_file(path: str | os.PathLike[str]) -> System | Mechanism:
    """Run a Python file and take its variable `system`, or else `mechanism`.

    A file that has not changed is not run again. What it prints goes to stderr. The path of an MJCF file that the
    system names is relative to the Python file.

    Args:
        path: a file that ends in .py, such as `keycld new` writes.

    Raises:
        InputError: if there is no such file, it does not run, or it has neither variable.
    """
    path = Path(path)
    if not is_mechanism_file(path) or not path.is_file():
        raise InputError(
            f"{path} is no Python file; name one that declares a mechanism, `keycld new my_arm` writes one."
        )
    about = path.stat()
    return _read(path, path.resolve(), about.st_mtime_ns, about.st_size)


def read_system(path: str | os.PathLike[str]) -> System:
    """The system that a Python file declares.

    Raises:
        InputError: as `read_mechanism_file`, or if the file has no `system`.
    """
    found = read_mechanism_file(path)
    if not isinstance(found, System):
        raise InputError(
            f"{path} declares a {MECHANISM} without a simulation; "
            f"set {SYSTEM} = keycld_envs.System(...) in it, as `keycld new` writes."
        )
    return found


def read_mechanism(path: str | os.PathLike[str]) -> Mechanism:
    """The keypoints, rods and sliders that a Python file declares, as `mechanism` or as part of its `system`.

    Raises:
        InputError: as `read_mechanism_file`.
    """
    found = read_mechanism_file(path)
    return found.mechanism if isinstance(found, System) else found


@functools.lru_cache(maxsize=32)
def _read(path: Path, place: Path, changed: int, size: int) -> System | Mechanism:
    """What a file declares; `changed` and `size` tell one content of it from another."""
    try:
        with contextlib.redirect_stdout(sys.stderr):
            names = runpy.run_path(str(place))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{path} does not run ({_reason(error, place)}); correct it.") from error
    for name, kind in ((SYSTEM, System), (MECHANISM, Mechanism)):
        if name in names and not isinstance(names[name], kind):
            raise InputError(
                f"{path} has a {type(names[name]).__name__} under the name {name!r}; "
                f"set {name} = keycld_envs.{kind.__name__}(...) in it."
            )
    found = names.get(SYSTEM, names.get(MECHANISM))
    if found is None:
        raise InputError(
            f"{path} has no variable {SYSTEM!r} or {MECHANISM!r}; set {SYSTEM} = keycld_envs.System(...) in it, "
            f"or {MECHANISM} = keycld_envs.Mechanism(...) for a video of your own."
        )
    if isinstance(found, System) and isinstance(found.mjcf, Path):
        found = replace(found, mjcf=place.parent / found.mjcf)
    return found


def _reason(error: BaseException, place: Path) -> str:
    """An error in one line, with the line of the file that it came from."""
    lines = [error.lineno] if isinstance(error, SyntaxError) and error.lineno else []
    step = error.__traceback__
    while step is not None:
        if step.tb_frame.f_code.co_filename == str(place):
            lines.append(step.tb_lineno)
        step = step.tb_next
    text = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split()).rstrip(".")
    return (f"line {lines[-1]}: " if lines else "") + f"{type(error).__name__}: {text}"
