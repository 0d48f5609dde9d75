"""Functions by a name, or by where they are: "module:function"."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from keycld_envs.errors import InputError


def function_of(name: str, places: Mapping[str, str]) -> Any:
    """A function of a table, or one's own as "module:function".

    Raises:
        InputError: if there is none.
    """
    module, _, function = places.get(name, name).partition(":")
    try:
        return getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"There is no method {name!r} ({error}); choose one of {', '.join(places)}, or module:function."
        ) from error
