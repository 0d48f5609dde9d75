"""Which column is what: the way from a table to a recording."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.checks import short
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.table import Table
from keycld_envs.recordings.recording import Recording

Array = NDArray[np.float64]
UNITS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "rad": {"rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180, "rpm": np.pi / 30},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "N m": {"N m": 1.0, "mN m": 1e-3},
    "N": {"N": 1.0},
    "1": {"1": 1.0, "%": 1e-2},
    "V": {"V": 1.0},
    "A": {"A": 1.0, "mA": 1e-3},
}
"""By the unit that recordings have: those of the same kind, and what each is worth in it."""
FACTORS = {unit: factor for units in UNITS.values() for unit, factor in units.items()}
BASE = {unit: base for base, units in UNITS.items() for unit in units}
INTEGRALS = {"rad/s": "rad", "m/s": "m"}
"""Units of speeds, and of the positions that they add up to."""
POSITIONS, COMMANDS = ("rad", "m", *INTEGRALS), ("N m", "N", "1", "V", "A", "rad", "m", "rad/s", "m/s")
"""What joints and actuators may have."""
TURN = 2 * np.pi * 1.01
"""Range of angles that were wrapped to one turn, rad, with a little noise."""
LONGEST_STEP, ROWS = 1.0, 20
"""Between two rows, from which on a clock of so many rows without a stated unit may as well be in ms."""
MOST_TURNS = 2.0
"""Turns either way beyond which angles without a stated unit may as well be degrees."""


@dataclass(frozen=True)
class Columns:
    """Which column of a table is what.

    Attributes:
        time: clock of joints and, unless it has its own, of actions.
        joints: columns of positions by joint, in the simulator's order; one of speeds is added up, from zero on, which
            is known by its unit.
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

    def __post_init__(self) -> None:
        """Raise InputError if a field is of another kind."""
        for name, wanted in (("time", str), ("action_time", str | None)):
            if not isinstance(getattr(self, name), wanted):
                raise InputError(f"{name} must name a column, got {short(getattr(self, name))}.")
        for name in ("joints", "velocities", "actions", "units"):
            value = getattr(self, name)
            words = [*value, *value.values()] if isinstance(value, Mapping) else [None]
            if not all(isinstance(word, str) for word in words):
                raise InputError(f"{name} must map names to names, got {short(value)}.")


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

    Clocks stay as they are, and so does NaN in positions and velocities; angles within one turn are unwrapped.

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
            unknown or of something else, angles without a unit may be degrees or a clock without one ms, a column
            holds nothing, or an action is missing; the message names file, column and line.
    """
    _check_columns(table, columns)
    signals, units = _signals(table, columns)
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


def _signals(table: Table, columns: Columns) -> tuple[dict[str, Any], dict[str, tuple[str, ...]]]:
    """Clocks, positions, velocities and actions as a recording has them, and their units."""
    clock = _clock(table, columns.time, columns.units)
    if columns.time not in columns.units:
        _check_seconds(table, columns.time, clock)
    action_clock = clock if columns.action_time is None else _clock(table, columns.action_time, columns.units)
    measured = _units(columns.joints, columns.units, "rad")
    positions = _signal(table, columns.joints, columns.units, columns.time, clock)
    for j, (unit, column) in enumerate(zip(measured, columns.joints.values(), strict=True)):
        if unit in INTEGRALS:
            positions[:, j] = _added_up(table, clock, positions[:, j])
        elif unit == "rad":
            if column not in columns.units:
                _check_radians(table, column, positions[:, j])
            positions[:, j] = unwrap(positions[:, j])
    units: dict[str, tuple[str, ...]] = {"qpos": tuple(INTEGRALS.get(unit, unit) for unit in measured)}
    signals: dict[str, Any] = {"t_state": clock, "qpos": positions}
    if columns.velocities:
        written = zip(columns.velocities.values(), units["qpos"], strict=True)
        units["qvel"] = tuple(_unit(columns.units.get(name, f"{unit}/s")) for name, unit in written)
        signals["qvel"] = _signal(table, columns.velocities, columns.units, columns.time, clock)
    if columns.actions:
        name = columns.action_time or columns.time
        units["action"] = _units(columns.actions, columns.units, "N m")
        action = _signal(table, columns.actions, columns.units, name, action_clock)
        signals |= {"t_action": action_clock, "action": _complete(table, columns, action)}
    return signals, units


def _check_seconds(table: Table, name: str, clock: Array) -> None:
    """Refuse a clock without a stated unit that may as well be in ms, us or ns."""
    step = float(np.median(np.diff(clock))) if len(clock) >= ROWS else 0.0
    if step >= LONGEST_STEP:
        raise InputError(
            f"{table.path}, column {name!r}: a row every {step:.4g} may be of ms, us or ns; say which unit the clock "
            f"has, --unit {name}=ms or --unit {name}=s."
        )


def _added_up(table: Table, clock: Array, speed: Array) -> Array:
    """The position that a speed leads to, from zero on (trapezoidal rule)."""
    if np.isnan(speed).any():
        row = table.row(int(np.isnan(speed).argmax()))
        raise InputError(f"{table.path}, {row}: a speed is missing, so that it cannot be added up; enter it.")
    return np.concatenate([[0.0], np.cumsum(np.diff(clock) * (speed[1:] + speed[:-1]) / 2)])


def unwrap(angle: Array) -> Array:
    """Remove jumps of 2π from an angle `[N]`, rad; NaN stays, and does not hide a jump.

    What turns further than once was not wrapped, and stays as it is.
    """
    out, good = angle.copy(), np.isfinite(angle)
    if good.any() and np.ptp(angle[good]) <= TURN:
        out[good] = np.unwrap(angle[good])
    return out


def _check_radians(table: Table, column: str, angle: Array) -> None:
    """Refuse angles without a stated unit that may as well be degrees."""
    q = angle[np.isfinite(angle)]
    if not len(q):
        return
    jumps = np.abs(np.diff(q)).max(initial=0.0)
    if np.abs(q).max() > 2 * np.pi * MOST_TURNS or (np.ptp(q) > TURN and jumps > np.pi):
        raise InputError(
            f"{table.path}, column {column!r}: positions from {q.min():.4g} to {q.max():.4g} may be degrees; say which "
            f"unit they have, --unit {column}=deg or --unit {column}=rad."
        )


def _check_columns(table: Table, columns: Columns) -> None:
    """Refuse unknown units, no joints, and velocities of other joints than positions."""
    for column, unit in columns.units.items():
        table.column(column)
        factor, written = _parted(unit)
        if written not in FACTORS or not 0 < abs(factor) < math.inf:
            raise InputError(
                f"{table.path}: the unit {unit!r} of {column!r} is unknown; known are {list(FACTORS)}, also with a "
                "factor in front, such as '50 N m' behind a gear."
            )
    if not columns.joints:
        raise InputError(f"{table.path}: no joint has a column; name one per joint, --joint hinge=COLUMN.")
    if columns.velocities and list(columns.velocities) != list(columns.joints):
        raise InputError(
            f"{table.path}: velocities are named for {list(columns.velocities)}, positions for {list(columns.joints)}; "
            "name a velocity for every joint, in the same order, or for none."
        )
    _check_units(table, columns)


def _check_units(table: Table, columns: Columns) -> None:
    """Refuse units of something else than what a column is."""
    wanted: list[tuple[str, tuple[str, ...], str]] = [(columns.time, ("s",), "a clock")]
    wanted += [(columns.action_time, ("s",), "a clock")] if columns.action_time is not None else []
    wanted += [(name, POSITIONS, "a joint's position") for name in columns.joints.values()]
    for joint, name in columns.velocities.items():
        base = _unit(columns.units.get(columns.joints[joint], "rad"))
        base = INTEGRALS.get(base, base)
        wanted.append((name, (f"{base}/s",), f"the velocity of a joint in {base}"))
    wanted += [(name, COMMANDS, "a command") for name in columns.actions.values()]
    for name, bases, what in wanted:
        unit = columns.units.get(name)
        if unit is not None and _unit(unit) not in bases:
            known = ", ".join(u for base in bases for u in UNITS[base])
            raise InputError(f"{table.path}: {name!r} is {what}, which is not in {unit!r}; its unit may be {known}.")


def _clock(table: Table, name: str, units: Mapping[str, str]) -> Array:
    time = table.column(name) * _factor(units.get(name, "s"))
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
        if np.isnan(values).all():
            raise InputError(f"{table.path}, column {name!r} holds no number; name another column.")
        out[:, j] = values * _factor(units.get(name, "1"))
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
    base = _parted(written)[1]
    return BASE.get(base, base)


def _factor(written: str) -> float:
    """What one of a column is worth in the recording's unit."""
    factor, unit = _parted(written)
    return factor * FACTORS[unit]


def _parted(written: str) -> tuple[float, str]:
    """A factor, one if there is none, and a unit: "50 N m" is 50 of "N m"."""
    first, _, rest = written.strip().partition(" ")
    if written in FACTORS or not rest:
        return 1.0, written
    try:
        return float(first), rest.strip()
    except ValueError:
        return 1.0, written
