"""Make recordings of a CSV, JSON, MATLAB or MCAP file, or of a data set of LeRobot or Minari."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional, UseAppendAction

from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from keycld_envs.recordings.importers import Columns


@dataclass(frozen=True)
class Args:
    """Make a recording of a file, or a folder of recordings of a data set: say which column is what.

    For instance: keycld import log.csv --out data/log --time t --joint hinge=angle --action motor=torque

    Attributes:
        file: CSV file with a header, JSON log (.json, .jsonl), MATLAB file (.mat) up to version 7, file of EPOS
            Studio's recorder, MCAP file (.mcap); or the folder of a data set of LeRobot v3 or Minari.
        out: Folder to create.
        time: Column of the clock; a data set of LeRobot has its own, and `step` of Minari's takes --unit 'step=0.05 s'.
        joint: Column of each joint's position, as JOINT=COLUMN, once for each joint, in the simulator's order; a speed,
            by its unit, is added up. By default those that a data set itself names.
        velocity: Column of each joint's measured velocity, as JOINT=COLUMN.
        action: Column of each actuator's command, as ACTUATOR=COLUMN.
        action_time: Column of the actions' clock, if they have their own.
        unit: Units of columns that are not in s, rad, rad/s and N m, as COLUMN=UNIT (ms, deg, rpm, m, ...); a data set
            needs those of all columns, or of whole signals, as action=deg.
        columns: Names of the columns of a CSV file without a header.
        camera: Name of a data set's frames to import, none for none; by default the first.
        hold: An empty cell of an action means that the command before it holds.
        drop_truncated_end: Leave out a last line that was cut short.
        licence: Of the data.
        origin: Where the data come from; by default the file's name.
        system: Environment that the data are from, if it is one.
        json: Print one JSON object.
    """

    file: Positional[Path]
    out: Path
    time: str | None = None
    joint: UseAppendAction[tuple[str, ...]] = ()
    velocity: UseAppendAction[tuple[str, ...]] = ()
    action: UseAppendAction[tuple[str, ...]] = ()
    action_time: str | None = None
    unit: UseAppendAction[tuple[str, ...]] = ()
    columns: tuple[str, ...] = ()
    camera: str | None = None
    hold: bool = False
    drop_truncated_end: bool = False
    licence: str = ""
    origin: str = ""
    system: str | None = None
    json: bool = False


def run(args: Args) -> None:
    """Read, write, and say what was read."""
    from keycld_envs import resolve_env_id

    system = None if args.system is None else resolve_env_id(args.system)
    about = {"licence": args.licence, "origin": args.origin, "system": system}
    result = _import_data_set(args, about) if args.file.is_dir() else _import_file(args, about)
    print_result(result, as_json=args.json)


def _import_file(args: Args, about: dict[str, Any]) -> dict[str, Any]:
    import numpy as np

    from keycld_envs.errors import InputError
    from keycld_envs.recordings import write_recording
    from keycld_envs.recordings.importers import assemble, read_log

    table, known = read_log(args.file, args.columns or None, drop_truncated_end=args.drop_truncated_end)
    if args.time is None:
        raise InputError(f"{args.file}: no column is named for the clock; name it, --time COLUMN.")
    recording = assemble(table, _columns(args, args.time, known), args.out.name, **about)
    write_recording(args.out, recording)
    assert recording.t_state is not None and recording.qpos is not None
    return {
        "recording": args.out,
        "samples": len(recording.t_state),
        "seconds": float(np.ptp(recording.t_state)),
        "missing": int(np.isnan(recording.qpos).sum()),
        "joints": recording.joint_names,
        "actuators": recording.actuator_names,
    }


def _import_data_set(args: Args, about: dict[str, Any]) -> dict[str, Any]:
    from dataclasses import replace

    from keycld_envs.errors import InputError
    from keycld_envs.files import atomic_folder
    from keycld_envs.progress import progress
    from keycld_envs.recordings import write_recording
    from keycld_envs.recordings.importers import expand_units, open_data_set

    data = open_data_set(args.file, args.camera)
    recording, samples = None, 0
    try:
        with atomic_folder(args.out) as folder, progress("Import", data.length) as advance:
            for episode in data:
                columns = None
                if args.joint or args.unit or args.time:
                    columns = _columns(args, args.time or episode.columns.time, {})
                    if not args.joint:
                        columns = replace(episode.columns, time=columns.time, units=columns.units)
                    columns = replace(columns, units=expand_units(columns.units, list(episode.table.columns)))
                recording = episode.recording(columns, **about)
                write_recording(folder / episode.folder_name(recording.id), recording)
                samples += len(recording.t_state if recording.t_state is not None else recording.t_frame or ())
                advance()
    except FileExistsError as error:
        raise InputError(f"{args.out} exists already; choose another folder or remove it.") from error
    assert recording is not None
    return {
        "recordings": args.out,
        "episodes": data.length,
        "samples": samples,
        "frames": None if recording.frames is None else f"{recording.frames.shape[2]}×{recording.frames.shape[1]}",
        "joints": recording.joint_names,
        "actuators": recording.actuator_names,
    }


def _columns(args: Args, time: str, known: dict[str, str]) -> "Columns":
    from keycld_control.cli._pairs import pairs
    from keycld_envs.recordings.importers import Columns

    return Columns(
        time,
        pairs("--joint", args.joint),
        pairs("--velocity", args.velocity),
        pairs("--action", args.action),
        args.action_time,
        known | pairs("--unit", args.unit),
        args.hold,
    )
