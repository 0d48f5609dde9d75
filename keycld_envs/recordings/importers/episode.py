"""Data sets of many episodes: what their importers read of each, and how a recording comes of it."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.mapping import Columns, assemble
from keycld_envs.recordings.importers.table import Table
from keycld_envs.recordings.recording import Recording
from keycld_envs.recordings.storage import META


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of a data set in another format.

    Attributes:
        id: name, unique in the data set.
        table: all columns of numbers.
        columns: which is what, by the names that the format itself fixes.
        frames: [T, H, W, 3] uint8 on the clock of `columns`, if there are any.
        fields: of `Recording`, which `keycld export` wrote beside the data; empty for data of others.
    """

    id: str
    table: Table
    columns: Columns
    frames: NDArray[np.uint8] | None = None
    fields: Mapping[str, Any] = field(default_factory=dict)

    def recording(self, columns: Columns | None = None, **fields: Any) -> Recording:
        """Make a recording.

        Args:
            columns: which column is what, with the units of all; by default those of this episode.
            **fields: licence, origin and system of data of others; see `assemble`.

        Raises:
            InputError: as `assemble` does.
        """
        if columns is None:
            if self.fields:
                return self._restored()
            columns = self.columns
        self._check_units(columns)
        out = assemble(self.table, columns, self.id, **fields)
        if self.frames is None:
            return out
        return replace(out, t_frame=out.t_state, frames=self.frames, camera=_camera(self.frames))

    def folder_name(self, id: str) -> str:
        """Where to store it: the recording's id, if that is a plain name."""
        return id if re.fullmatch(r"[\w -][\w. -]*", id) else self.id

    def _restored(self) -> Recording:
        """The recording that was exported; its units stay as they are written."""
        signals: dict[str, Any] = {}
        if self.columns.joints:
            signals |= {"t_state": self.table.column(self.columns.time), "qpos": self._stack(self.columns.joints)}
        if self.columns.velocities:
            signals["qvel"] = self._stack(self.columns.velocities)
        if self.columns.actions:
            clock = self.columns.action_time or self.columns.time
            signals |= {"t_action": self.table.column(clock), "action": self._stack(self.columns.actions)}
        if self.frames is not None:
            signals |= {"t_frame": self.table.column(self.columns.time), "frames": self.frames}
        return Recording(**self.fields, **signals)

    def _check_units(self, columns: Columns) -> None:
        """Refuse to guess: these formats do not say what their numbers mean. Columns that are missing come first."""
        for name in (columns.time, *columns.joints.values(), *columns.velocities.values(), *columns.actions.values()):
            self.table.column(name)
        for group in (columns.joints, columns.velocities, columns.actions):
            names = list(group.values())
            if missing := [name for name in names if name not in columns.units]:
                name, first = missing[0], names[0]
                wholes = [first[: end.start()] for end in re.finditer(r"[.\[]", first)]
                whole = max((w for w in wholes if all(n.startswith(w) for n in names)), key=len, default=first)
                raise InputError(
                    f"{self.table.path} does not say which unit {name!r} has; say it, --unit {name}=deg, or of all at "
                    f"once, --unit {whole}=deg."
                )

    def _stack(self, names: Mapping[str, str]) -> NDArray[np.float64]:
        return np.stack([self.table.column(column) for column in names.values()], axis=1)


def stored_fields(written: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a recording as `exporters.rows.about` wrote them to JSON, which has no tuples.

    Raises:
        ValueError: if they are others.
    """
    if set(written) != set(META):
        raise ValueError("the fields of the recordings in it are damaged")
    out = dict(written)
    out["units"] = {name: tuple(u) if isinstance(u, list) else u for name, u in written["units"].items()}
    return out | {name: tuple(written[name]) for name in ("joint_names", "actuator_names")}


def expand_units(units: Mapping[str, str], columns: Sequence[str]) -> dict[str, str]:
    """Let a unit of a signal, `action`, be that of its columns `action.elbow` or `action[0]` that have no other."""
    out = {}
    for name, unit in units.items():
        inside = [c for c in columns if c.startswith((f"{name}.", f"{name}["))]
        out |= {column: unit for column in inside if name not in columns and column not in units} or {name: unit}
    return out


def _camera(frames: NDArray[np.uint8]) -> dict[str, int]:
    return {"width": frames.shape[2], "height": frames.shape[1]}
