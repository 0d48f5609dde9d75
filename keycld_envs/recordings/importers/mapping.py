"""Which column is what: the way from a table to a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.table import Table
from keycld_envs.recordings.recording import Recording

Array = NDArray[np.float64]
FACTORS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
    "rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "m": 1.0, "cm": 1e-2, "mm": 1e-3,
    "rad/s": 1.0, "deg/s": np.pi / 180, "rpm": np.pi / 30, "m/s": 1.0, "mm/s": 1e-3,
    "N m": 1.0, "mN m": 1e-3, "N": 1.0, "1": 1.0, "V": 1.0, "A": 1.0,
}  # fmt: skip
"""What a unit is worth in the recording's unit of its kind."""
BASE = {
    "ms": "s", "us": "s", "ns": "s", "deg": "rad", "rev": "rad", "cm": "m", "mm": "m", "deg/s": "rad/s",
    "rpm": "rad/s", "mm/s": "m/s", "mN m": "N m",
}  # fmt: skip


@dataclass(frozen=True)
class Columns:
    """Which column of a table is what.

    Attributes:
        time: clock of joints and, unless it has its own, of actions.
        joints: columns of positions by joint, in the simulator's order.
        velocities: columns of measured velocities by joint; all joints or none.
        actions: columns of commands by actuator.
        action_time: clock of the actions.
        units: of columns that are not in s, rad, rad/s and N m.
        hold: an empty cell of an action means that the command stays as it was; otherwise it is refused.
    """

    time: str
    joints: Mapping[str, str]
    velocities: Mapping[str, str] = field(default_factory=dict)
    actions: Mapping[str, str] = field(default_factory=dict)
    action_time: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    hold: bool = False


def assemble(
    table: Table,
    columns: Columns,
    id: str,
    *,
    licence: str = "",
    origin: str = "",
    notes: str = "",
    system: str | None = None,
) -> Recording:
    """Make a recording of a real system from a table.

    Clocks stay as they are, and so does NaN in positions and velocities; angles are unwrapped.

    Args:
        table: columns of numbers.
        columns: which is what.
        id: of the recording.
        licence: of the data.
        origin: where they come from; by default the file's name.
        notes: anything else.
        system: environment id, if it is one.

    Raises:
        InputError: if a column is missing, lengths differ, a clock misses a time or runs backwards, a unit is
            unknown, or an action is missing; the message names file, column and line.
    """
    for column, unit in columns.units.items():
        table.column(column)
        if unit not in FACTORS:
            raise InputError(f"{table.path}: the unit {unit!r} of {column!r} is unknown; known are {list(FACTORS)}.")
    if not columns.joints:
        raise InputError(f"{table.path}: no joint has a column; name one per joint, --joint hinge=COLUMN.")
    if columns.velocities and list(columns.velocities) != list(columns.joints):
        raise InputError(
            f"{table.path}: velocities are named for {list(columns.velocities)}, positions for {list(columns.joints)}; "
            "name a velocity for every joint, in the same order, or for none."
        )
    clock = _clock(table, columns.time, columns.units)
    action_clock = clock if columns.action_time is None else _clock(table, columns.action_time, columns.units)
    units: dict[str, tuple[str, ...]] = {"qpos": _units(columns.joints, columns.units, "rad")}
    signals: dict[str, Any] = {
        "t_state": clock,
        "qpos": _signal(table, columns.joints, columns.units, columns.time, clock),
    }
    for j, unit in enumerate(units["qpos"]):
        if unit == "rad":
            signals["qpos"][:, j] = unwrap(signals["qpos"][:, j])
    if columns.velocities:
        written = zip(columns.velocities.values(), units["qpos"], strict=True)
        units["qvel"] = tuple(_unit(columns.units.get(name, f"{unit}/s")) for name, unit in written)
        signals["qvel"] = _signal(table, columns.velocities, columns.units, columns.time, clock)
    if columns.actions:
        name = columns.action_time or columns.time
        units["action"] = _units(columns.actions, columns.units, "N m")
        action = _signal(table, columns.actions, columns.units, name, action_clock)
        signals |= {"t_action": action_clock, "action": _complete(table, columns, action)}
    return Recording(
        id=id,
        source="real",
        system=system,
        joint_names=tuple(columns.joints),
        actuator_names=tuple(columns.actions),
        units=units,
        licence=licence,
        origin=origin or table.path.name,
        notes=notes,
        **signals,
    )


def unwrap(angle: Array) -> Array:
    """Remove jumps of 2π from an angle `[N]`, rad; NaN stays, and does not hide a jump."""
    out, good = angle.copy(), np.isfinite(angle)
    out[good] = np.unwrap(angle[good])
    return out


def _clock(table: Table, name: str, units: Mapping[str, str]) -> Array:
    time = table.column(name) * FACTORS[units.get(name, "s")]
    if len(bad := np.flatnonzero(~np.isfinite(time))):
        raise InputError(f"{table.path}, {table.row(bad[0])}, column {name!r}: the time is missing; remove the row.")
    if len(back := np.flatnonzero(np.diff(time) < 0)):
        i = back[0] + 1
        raise InputError(
            f"{table.path}, {table.row(i)}, column {name!r}: {time[i]:g} s comes after {time[i - 1]:g} s; a clock "
            "never runs backwards, sort the rows by time or cut the file there."
        )
    return time


def _signal(table: Table, names: Mapping[str, str], units: Mapping[str, str], clock_name: str, clock: Array) -> Array:
    """`[N, k]` in the recording's units."""
    out = np.empty((len(clock), len(names)))
    for j, name in enumerate(names.values()):
        values = table.column(name)
        if len(values) != len(clock):
            raise InputError(
                f"{table.path}: {name!r} has {len(values)} values, its clock {clock_name!r} has {len(clock)}; name the "
                "clock that belongs to it."
            )
        if len(bad := np.flatnonzero(np.isinf(values))):
            raise InputError(
                f"{table.path}, {table.row(bad[0])}, column {name!r}: {values[bad[0]]} is no measurement; leave the "
                "cell empty."
            )
        out[:, j] = values * FACTORS[units.get(name, "1")]
    return out


def _complete(table: Table, columns: Columns, action: Array) -> Array:
    """Without NaN."""
    for j, name in enumerate(columns.actions.values()):
        missing = np.isnan(action[:, j])
        if missing.any() and (missing[0] or not columns.hold):
            first = int(missing.argmax())
            raise InputError(
                f"{table.path}, {table.row(first)}, column {name!r}: the command is missing; enter it, or, where an "
                "empty cell means that the command before it holds, say so with --hold."
            )
        held = np.maximum.accumulate(np.where(missing, 0, np.arange(len(action))))
        action[:, j] = action[held, j]
    return action


def _units(names: Mapping[str, str], units: Mapping[str, str], default: str) -> tuple[str, ...]:
    return tuple(_unit(units.get(name, default)) for name in names.values())


def _unit(written: str) -> str:
    """The recording's unit of the kind."""
    return BASE.get(written, written)
