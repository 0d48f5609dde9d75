"""Gates as data: one TOML file each, in `gates/`, or one's own.

A rig that several gates use stands in `gates/rigs/`; a gate names it, and may write its tables anew. docs/real-data.md
has an example.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from keycld_control.benchmarks.real.concealed import ConcealedGate
from keycld_control.benchmarks.real.expectations import EXPECTATIONS
from keycld_control.benchmarks.real.fields import built, check_known, inside
from keycld_control.benchmarks.real.gate import DataSplit, Expectation, Gate, Runs
from keycld_control.benchmarks.real.halves import HalvesGate
from keycld_control.benchmarks.real.owners.all_rigs import owners_rigs
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.rigs import rig_of, tables_of
from keycld_control.benchmarks.real.runner import AnyGate
from keycld_envs.errors import InputError

HERE = Path(__file__).parent
RIG = ("simulator", "columns", "files", "licence", "origin")
"""Fields of a rig."""


@dataclass(frozen=True)
class Diagnosis:
    """One call of `diagnose`; names are of files of the rig."""

    recordings: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    baseline: tuple[str, ...] = ()
    name: str = "diagnosis"


@dataclass(frozen=True)
class Drawn:
    """Runs of a rig that a gate draws from; see `gate.Runs`."""

    name: str
    rig: str
    files: tuple[str, ...]
    columns: Mapping[str, Any] = field(default_factory=dict)
    left: float = 0.0


@dataclass(frozen=True)
class Concealed:
    """Effects that are concealed in runs; see `concealed.ConcealedGate`."""

    cases: int
    nulls: float
    seed: int
    runs: tuple[Drawn, ...]


@dataclass(frozen=True)
class Halves:
    """Halves of runs that are compared; see `halves.HalvesGate`."""

    splits: int
    seed: int
    runs: tuple[Drawn, ...]
    budget: float | None = None


@dataclass(frozen=True)
class Owners:
    """Rigs whose corrected simulators are compared with what their owners identified; see `owners.gate.OwnersGate`."""

    rigs: tuple[str, ...]
    better: int
    worse: float
    named: tuple[str, ...] = ()
    model: str | None = None
    tested: bool = False


@dataclass(frozen=True)
class Declared:
    """All that a gate's file may say; the fields of a rig are written, or in the file of a rig that is named."""

    title: str
    rig: str | None = None
    licence: str = ""
    origin: str = ""
    simulator: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Any] = field(default_factory=dict)
    diagnosis: tuple[Diagnosis, ...] = ()
    expect: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    tracked: bool = False
    plotted: float = Gate.plotted
    concealed: Concealed | None = None
    halves: Halves | None = None
    owners: Owners | None = None


def gates() -> dict[str, AnyGate]:
    """All gates of this package by name, in the order of their names."""
    return {path.stem: read_gate(path) for path in sorted((HERE / "gates").glob("*.toml"))}


def read_gate(path: Path) -> AnyGate:
    """The gate of a file.

    Raises:
        InputError: if the file, or a field of it, is wrong.
    """
    where, tables = f"{path.name}:", tables_of(path)
    declared = built(Declared, tables, where)
    if declared.concealed is not None:
        c = declared.concealed
        return ConcealedGate(path.stem, declared.title, _drawn(c.runs, where), c.cases, c.nulls, c.seed)
    if declared.halves is not None:
        h = declared.halves
        return HalvesGate(path.stem, declared.title, _drawn(h.runs, where), h.splits, h.seed, h.budget)
    if declared.owners is not None:
        return _owners(path.stem, declared.title, declared.owners, where)
    for name in ("diagnosis", "expect"):
        if not getattr(declared, name):
            raise InputError(f"{inside(where, name)} is missing; write what is diagnosed, and what is expected of it.")
    own = rig_of(declared.rig, {name: tables[name] for name in RIG if name in tables}, where)
    diagnoses = {}
    for i, one in enumerate(declared.diagnosis):
        at = f"{where} diagnosis[{i}]"
        parts = {n: own.some(getattr(one, n), f"{at}.{n}") for n in ("recordings", "held_out", "baseline")}
        diagnoses[one.name] = DataSplit(**parts)
    expectations = _expectations(declared, tuple(diagnoses), where)
    return Gate(path.stem, declared.title, own.simulator, diagnoses, expectations, declared.tracked, declared.plotted)


def _owners(name: str, title: str, owners: Owners, where: str) -> OwnersGate:
    known, rigs = owners_rigs(), []
    for rig in owners.rigs:
        check_known(f"{where} owners.rigs", rig, known)
        rigs.append(replace(known[rig], model=owners.model, tested=owners.tested))
    return OwnersGate(name, title, rigs, owners.better, owners.worse, owners.named)


def _drawn(runs: tuple[Drawn, ...], where: str) -> list[Runs]:
    out = []
    for one in runs:
        own = rig_of(one.rig, {"columns": one.columns}, where)
        out.append(Runs(one.name, own.simulator, own.some(one.files, f"{where} runs.files"), one.left))
    return out


def _expectations(declared: Declared, diagnoses: tuple[str, ...], where: str) -> list[Expectation]:
    out = []
    for name, tables in declared.expect.items():
        check_known(inside(where, "expect"), name, dict(EXPECTATIONS))
        for i, table in enumerate(tables):
            at = f"{where} expect.{name}[{i}]"
            out.append(built(EXPECTATIONS[name], table, at))
            for meant in out[-1].of:
                check_known(f"{at}.of", meant, diagnoses)
    return out
