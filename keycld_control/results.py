"""Results of work that goes on where it was stopped: a JSON file each, in the folder `results`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from keycld_envs.errors import InputError
from keycld_envs.reading import read_json


def read_results(out: Path, version: str) -> Iterator[tuple[Path, dict[str, Any]]]:
    """All that are there, in order of their names, with their files.

    Args:
        out: the folder that holds `results`.
        version: their schema.

    Raises:
        InputError: if a file is damaged or of another version.
    """
    for path in sorted((out / "results").glob("*.json")):
        try:
            result = read_json(path)
            schema = result["schema"]
        except (ValueError, LookupError, TypeError) as error:
            raise InputError(f"{path} is damaged ({error}); remove it, and its model is measured again.") from error
        if schema != version:
            raise InputError(f"{path} has schema {schema!r}, this version reads {version!r}; remove it.")
        yield path, result
