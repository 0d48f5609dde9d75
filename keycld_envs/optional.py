"""Packages that only some formats need: extras of this one, imported when they are used."""

from importlib import import_module
from typing import Any

from keycld_envs.errors import InputError


class MissingPackage(InputError):
    """A package that an extra of keycld installs is absent."""


def optional(module: str, extra: str, purpose: str) -> Any:
    """Import a module of a package that may be absent.

    Args:
        module: its name, such as "pyarrow.parquet".
        extra: the extra of keycld that installs the package.
        purpose: what needs it, as the sentence's subject in the plural ("LeRobot data sets").

    Raises:
        MissingPackage: if it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = (error.name or module).partition(".")[0]
        raise MissingPackage(
            f"{purpose} need the package {package!r}, which is not installed; run pip install 'keycld[{extra}]'."
        ) from error
