"""Frozen dataclasses of tables that people write: every field checked, and every fault told by file and field."""

import difflib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from keycld_envs.checks import short
from keycld_envs.errors import InputError

T = TypeVar("T")
WORDS = {str: "text", float: "a number", int: "a whole number", bool: "true or false"}


def built(kind: type[T], table: object, where: str) -> T:
    """A dataclass whose fields are those of a table; tables in it become the dataclasses that it asks for.

    Args:
        kind: the dataclass.
        table: as TOML has it. A list may be written as its only item.
        where: file and field, for messages, such as "rig.toml: simulator".

    Raises:
        InputError: if a field is missing, unknown, or of another kind.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{where} is {short(table)}; it must be a table of fields.")
    hints, own = get_type_hints(kind), {f.name: f for f in fields(kind)}  # pyright: ignore[reportArgumentType]
    for name in table:
        check_known(f"{where} the field" if where.endswith(":") else f"{where}: the field", name, own)
    needed = [n for n, f in own.items() if f.default is MISSING and f.default_factory is MISSING]
    if missing := [name for name in needed if name not in table]:
        raise InputError(f"{inside(where, missing[0])} is missing; write it down.")
    values = {name: _value(hints[name], value, inside(where, name)) for name, value in table.items()}
    try:
        return kind(**values)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def check_known(what: str, name: object, known: Mapping[str, Any] | tuple[str, ...]) -> None:
    """Raise InputError if a name is none of those that there are."""
    if name not in known:
        near = difflib.get_close_matches(str(name), known, 1)
        choice = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known) or 'none'}."
        raise InputError(f"{what} {name!r} is unknown; {choice}")


def inside(where: str, name: object) -> str:
    """A field of a table."""
    return f"{where} {name}" if where.endswith(":") else f"{where}.{name}"


def _value(kind: Any, value: object, where: str) -> Any:
    origin, args = get_origin(kind), get_args(kind)
    if is_dataclass(kind):
        return built(kind, value, where)  # pyright: ignore[reportArgumentType]
    if origin in (Union, UnionType):
        kinds = [k for k in args if k is not NoneType]
        fitting = [k for k in kinds if k in WORDS and _is(k, value)]
        return _value((fitting or kinds)[0], value, where)
    if origin is tuple and args[1:] == (...,):
        items = value if isinstance(value, list) else [value]
        return tuple(_value(args[0], item, f"{where}[{i}]") for i, item in enumerate(items))
    if origin is tuple:
        if not isinstance(value, list) or len(value) != len(args):
            raise InputError(f"{where} is {short(value)}; it must be a list of {len(args)}.")
        return tuple(_value(k, item, f"{where}[{i}]") for i, (k, item) in enumerate(zip(args, value, strict=True)))
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise InputError(f"{where} is {short(value)}; it must be a table.")
        return {str(k): _value(args[1], v, inside(where, k)) for k, v in value.items()}
    if kind is Any:
        return value
    if not _is(kind, value):
        raise InputError(f"{where} is {short(value)}; it must be {WORDS[kind]}.")
    return kind(value)


def _is(kind: type, value: object) -> bool:
    """Whether a value is of a kind; whole numbers are numbers, and neither are true and false."""
    return isinstance(value, (int, float) if kind is float else kind) and (kind is bool or not isinstance(value, bool))
