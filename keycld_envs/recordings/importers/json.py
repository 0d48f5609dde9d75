"""Logs in JSON: a list of samples, alone or beside settings, columns, or one sample per line."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.reading import JSON_SHARE, check_file, parse_json
from keycld_envs.recordings.importers.table import Table


def read_json_log(path: str | os.PathLike[str]) -> Table:
    """Read a log from a JSON file, or from one with a sample per line.

    Samples are objects, in a list: the whole file, its lines, or one entry of the file's object. A number `x` in each
    becomes the column "x", one inside another object "a.x", an entry of a list "x[0]"; true is 1, false 0. Numbers
    beside the samples, such as a gain, become constant columns. An object of lists of numbers has a column each.

    Args:
        path: the file.

    Returns:
        All columns; numbers that a sample lacks are NaN, and what is text in any sample is left out.

    Raises:
        InputError: if the file is missing, damaged, too large, or holds no samples, or two lists of them.
    """
    path = Path(path)
    try:
        content = check_file(path, JSON_SHARE).read_bytes()
        settings, samples = _samples(_parsed(content))
        columns = _columns(samples) if isinstance(samples, list) else _vectors(samples)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name a JSON file.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read as a log ({error}); name a JSON file that holds samples.") from error
    length = max((len(c) for c in columns.values()), default=0)
    for name, value in numbers_in(settings):
        columns.setdefault(name, np.full(length, value))
    return Table(path, columns)


def _parsed(content: bytes) -> Any:
    """What the file says, or a list of what its lines say."""
    try:
        return parse_json(content)
    except ValueError:
        lines = [line for line in content.splitlines() if line.strip()]
        if len(lines) < 2 or not lines[0].lstrip().startswith(b"{"):
            raise
        return [parse_json(line) for line in lines]


def _samples(content: Any) -> tuple[Mapping[str, Any], list[Any] | Mapping[str, Any]]:
    """Settings, and samples or columns.

    Raises:
        ValueError: if there are none, or it is not clear which.
    """
    if isinstance(content, list):
        return {}, content
    if not isinstance(content, dict):
        raise ValueError("it is neither an object nor a list")
    lists = {name: value for name, value in content.items() if isinstance(value, list)}
    of_samples = [name for name, value in lists.items() if value and all(isinstance(v, dict) for v in value)]
    if len(of_samples) > 1:
        raise ValueError(f"it has two lists of samples, {of_samples[0]!r} and {of_samples[1]!r}")
    settings = {name: value for name, value in content.items() if name not in lists}
    if of_samples:
        return settings, lists[of_samples[0]]
    return settings, lists


def _columns(samples: list[Any]) -> dict[str, NDArray[np.float64]]:
    """Columns of samples.

    Raises:
        ValueError: if there are no samples, or one is no object.
    """
    wrong = next((i for i, sample in enumerate(samples) if not isinstance(sample, dict)), None)
    if wrong is not None or not samples:
        raise ValueError("it holds no samples" if not samples else f"sample {wrong} is no object of numbers")
    out: dict[str, NDArray[np.float64]] = {}
    for i, sample in enumerate(samples):
        for name, value in numbers_in(sample):
            if name not in out:
                out[name] = np.full(len(samples), np.nan)
            out[name][i] = value
    text = {name for sample in samples for name in _texts(sample)}
    return {name: column for name, column in out.items() if name not in text}


def _vectors(lists: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Columns that are lists of numbers already.

    Raises:
        ValueError: if there are none.
    """
    out = {}
    for name, values in lists.items():
        if values and all(value is None or isinstance(value, int | float) for value in values):
            out[name] = np.array([np.nan if value is None else _number(value) for value in values])
    if not out:
        raise ValueError("it holds no samples")
    return out


def numbers_in(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Names and values of all numbers inside."""
    if isinstance(value, int | float):
        yield name, _number(value)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from numbers_in(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from numbers_in(inner, f"{name}[{i}]")


def _texts(sample: Mapping[str, Any]) -> Iterator[str]:
    """Names of what is text."""
    return (name for name, value in sample.items() if isinstance(value, str))


def _number(value: int | float) -> float:
    """As a float.

    Raises:
        ValueError: if it has hundreds of digits.
    """
    try:
        return float(value)
    except OverflowError as error:
        raise ValueError("a number is too large") from error
