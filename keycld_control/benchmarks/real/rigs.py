"""Rigs as data: whose recordings, which column is what, and which simulator."""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import mujoco

from keycld_control.benchmarks.real.fields import built, check_known, inside
from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.simulators import simulator
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers import Columns, Table, read_csv, read_json_log, read_mat

HERE = Path(__file__).parent
SEVERAL = re.compile(r"\{(\d+\.\.\d+|[^{}]*,[^{}]*)\}")
"""In a text: {01..05} or {a,b}."""


@dataclass(frozen=True)
class Files:
    """Files of one kind, such as the runs of one controller; or the parts of one file.

    Attributes:
        path: from the folder with the data; {01..05} or {a,b} stand for several.
        id: of the recordings, with as many.
        columns: where they differ from those of the rig, also with as many.
        names: of the columns of a text table that has no header.
    """

    path: str
    id: str
    columns: Mapping[str, Any] = field(default_factory=dict)
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rig:
    """A mechanism.

    Attributes:
        simulator: makes its model, of the folder with the data.
        files: recordings by name.
    """

    simulator: Callable[[Path], mujoco.MjModel]
    files: Mapping[str, Sequence[RecordingFile]]

    def some(self, names: Sequence[str], where: str) -> list[RecordingFile]:
        """Recordings of several names.

        Raises:
            InputError: if there are none of a name.
        """
        for name in names:
            check_known(where, name, dict(self.files))
        return [file for name in names for file in self.files[name]]


def named_rig(name: str) -> Rig:
    """A rig of this package.

    Raises:
        InputError: if there is none of that name.
    """
    return rig_of(name, {}, "rigs:")


def rig_of(name: str | None, tables: Mapping[str, Any], where: str) -> Rig:
    """A rig of this package with tables that are written anew; of tables alone, if it has no name.

    Raises:
        InputError: if there is none of that name, or something is missing or wrong.
    """
    if name is None:
        return rig(tables, where)
    known = {path.stem: path for path in sorted((HERE / "gates" / "rigs").glob("*.toml"))}
    check_known(inside(where, "rig"), name, known)
    shared = tables_of(known[name])
    if "kind" in tables.get("simulator", {}):
        del shared["simulator"]  # another one, instead of other numbers
    return rig(merged(shared, tables), f"{where[:-1]}, {known[name].name}:")


def tables_of(path: Path) -> dict[str, Any]:
    """What a TOML file says.

    Raises:
        InputError: if it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); hand in a TOML file.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is no TOML ({error}); mend that line.") from error


def rig(tables: Mapping[str, Any], where: str) -> Rig:
    """A rig of the tables `simulator`, `columns` and `files`, and the texts `licence` and `origin`.

    Raises:
        InputError: if something is missing or wrong.
    """
    for name in ("simulator", "files"):
        if not isinstance(tables.get(name), Mapping):
            raise InputError(f"{inside(where, name)} is missing; write such a table, or name a rig that has it.")
    files = {}
    for name, table in tables["files"].items():
        own = inside(where, f"files.{name}")
        files[name] = _recordings(built(Files, table, own), tables, own)
    return Rig(simulator(tables["simulator"], inside(where, "simulator")), files)


def _recordings(files: Files, tables: Mapping[str, Any], where: str) -> list[RecordingFile]:
    columns = merged(tables.get("columns", {}), files.columns)
    out = []
    for path, id, own in several([files.path, files.id, columns], where):
        out.append(
            RecordingFile(
                path,
                built(Columns, own, inside(where, "columns")),
                id,
                str(tables.get("licence", "")),
                str(tables.get("origin", "")),
                partial(_read, names=files.names),
            )
        )
    if len({file.id for file in out}) < len(out):
        raise InputError(f"{inside(where, 'id')} is the same for {len(out)} files; write {{...}} in it, too.")
    return out


def _read(path: Path, names: Sequence[str]) -> Table:
    suffix = path.suffix.lower()
    if suffix in (".json", ".jsonl"):
        return read_json_log(path)
    return read_mat(path) if suffix == ".mat" else read_csv(path, names or None)


def merged(table: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """A table with the fields of another, table by table."""
    both = {k: merged(table[k], v) for k, v in other.items() if isinstance(v, Mapping) and k in table}
    return {**table, **other, **both}


def several(texts: list[Any], where: str) -> list[list[Any]]:
    """Texts, and tables of texts, with each thing that {01..05} or {a,b} in them stands for, all of them in step.

    Raises:
        InputError: if they stand for different numbers of things.
    """
    counts = {len(_choices(match)) for text in _texts(texts) for match in SEVERAL.finditer(text)}
    if len(counts) > 1:
        raise InputError(f"{where} has {{...}} for {' and for '.join(map(str, sorted(counts)))} things; write as many.")
    return [_one(texts, i) for i in range(max(counts, default=1))]


def _choices(match: re.Match[str]) -> list[str]:
    first, dots, last = match[1].partition("..")
    if dots and first.isdigit() and last.isdigit():
        return [str(i).zfill(len(first)) for i in range(int(first), int(last) + 1)]
    return [word.strip() for word in match[1].split(",")]


def _texts(value: Any) -> list[str]:
    if isinstance(value, str):
        return [value]
    items = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return [text for item in items for text in _texts(item)]


def _one(value: Any, index: int) -> Any:
    if isinstance(value, str):
        return SEVERAL.sub(lambda match: _choices(match)[index], value)
    if isinstance(value, Mapping):
        return {name: _one(item, index) for name, item in value.items()}
    return [_one(item, index) for item in value] if isinstance(value, list) else value
