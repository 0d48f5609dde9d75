"""Make recordings of CSV, JSON or MATLAB files."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional, UseAppendAction

from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from keycld_envs.recordings import Recording


@dataclass(frozen=True)
class Args:
    """Make recordings of CSV, JSON or MATLAB files: say which column is what.

    For instance: keycld import log.csv --out data/log --time t --joint hinge=angle --action motor=torque

    Or all at once, a recording of each in data/logs: keycld import logs/*.csv --out data/logs --time t ...

    Attributes:
        files: CSV file with a header, JSON log (.json, .jsonl), MATLAB file (.mat) up to version 7, or file of EPOS
            Studio's recorder; or several alike.
        out: Folder to create; of several files, the one that their recordings are put into, each named like its file.
        time: Column of the clock.
        joint: Column of each joint's position, as JOINT=COLUMN, once for each joint, in the simulator's order; a speed,
            by its unit, is added up.
        velocity: Column of each joint's measured velocity, as JOINT=COLUMN.
        action: Column of each actuator's command, as ACTUATOR=COLUMN.
        action_time: Column of the actions' clock, if they have their own.
        unit: Units of columns that are not in s, rad, rad/s and N m, as COLUMN=UNIT (ms, deg, rpm, m, ...).
        columns: Names of the columns of a CSV file without a header.
        hold: An empty cell of an action means that the command before it holds.
        drop_truncated_end: Leave out a last line that was cut short.
        licence: Of the data.
        origin: Where the data come from; by default the file's name.
        system: Environment that the data are from, if it is one.
        json: Print one JSON object.
    """

    files: Positional[tuple[Path, ...]]
    out: Path
    time: str
    joint: UseAppendAction[tuple[str, ...]]
    velocity: UseAppendAction[tuple[str, ...]] = ()
    action: UseAppendAction[tuple[str, ...]] = ()
    action_time: str | None = None
    unit: UseAppendAction[tuple[str, ...]] = ()
    columns: tuple[str, ...] = ()
    hold: bool = False
    drop_truncated_end: bool = False
    licence: str = ""
    origin: str = ""
    system: str | None = None
    json: bool = False


def run(args: Args) -> None:
    """Read all before the first is written, and say what was read."""
    from keycld_envs.errors import InputError
    from keycld_envs.progress import progress
    from keycld_envs.recordings import write_recording

    if not args.files:
        raise InputError("There is no file to import; name one, or several.")
    folders = [args.out] if len(args.files) == 1 else [args.out / file.stem for file in args.files]
    if twice := [folder for folder in folders if folders.count(folder) > 1]:
        raise InputError(f"Several files would become {twice[0]}; rename one of them.")
    recordings = []
    with progress("Importing", total=len(folders)) as advance:
        for file, folder in zip(args.files, folders, strict=True):
            recordings.append(_read(args, file, folder.name))
            advance()
    if there := [folder for folder in folders if folder.is_dir() and any(folder.iterdir())]:
        raise InputError(f"{there[0]} exists and is not empty; choose another folder, or remove it.")
    for folder, recording in zip(folders, recordings, strict=True):
        write_recording(folder, recording)
    results = [_summary(*pair) for pair in zip(folders, recordings, strict=True)]
    if len(results) == 1:
        print_result(results[0], as_json=args.json)
    elif args.json:
        print_result({"recordings": results}, as_json=True)
    else:
        print_result(
            {str(r["recording"]): f"{r['samples']} samples, {r['seconds']:.4g} s" for r in results}, as_json=False
        )


def _read(args: Args, file: Path, name: str) -> "Recording":
    """One file as a recording."""
    from keycld_control.cli._pairs import pairs
    from keycld_envs import resolve_env_id
    from keycld_envs.recordings.importers import Columns, assemble, read_log

    table, known = read_log(file, args.columns or None, drop_truncated_end=args.drop_truncated_end)
    columns = Columns(
        args.time,
        pairs("--joint", args.joint),
        pairs("--velocity", args.velocity),
        pairs("--action", args.action),
        args.action_time,
        known | pairs("--unit", args.unit),
        args.hold,
    )
    system = None if args.system is None else resolve_env_id(args.system)
    return assemble(table, columns, name, licence=args.licence, origin=args.origin, system=system)


def _summary(folder: Path, recording: "Recording") -> dict[str, Any]:
    """What was read of one file."""
    import numpy as np

    assert recording.t_state is not None and recording.qpos is not None
    return {
        "recording": folder,
        "samples": len(recording.t_state),
        "seconds": float(np.ptp(recording.t_state)),
        "missing": int(np.isnan(recording.qpos).sum()),
        "joints": recording.joint_names,
        "actuators": recording.actuator_names,
    }
