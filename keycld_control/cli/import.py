"""Make a recording of a CSV, JSON or MATLAB file."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional, UseAppendAction

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Make a recording of a CSV, JSON or MATLAB file: say which column is what.

    For instance: keycld import log.csv --out data/log --time t --joint hinge=angle --action motor=torque

    Attributes:
        file: CSV file with a header, JSON log (.json, .jsonl), MATLAB file (.mat) up to version 7, or file of EPOS
            Studio's recorder.
        out: Folder to create.
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

    file: Positional[Path]
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
    """Read, write, and say what was read."""
    import numpy as np

    from keycld_control.cli._pairs import pairs
    from keycld_envs import resolve_env_id
    from keycld_envs.recordings import write_recording
    from keycld_envs.recordings.importers import Columns, assemble, read_log

    table, known = read_log(args.file, args.columns or None, drop_truncated_end=args.drop_truncated_end)
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
    recording = assemble(table, columns, args.out.name, licence=args.licence, origin=args.origin, system=system)
    write_recording(args.out, recording)
    assert recording.t_state is not None and recording.qpos is not None
    result = {
        "recording": args.out,
        "samples": len(recording.t_state),
        "seconds": float(np.ptp(recording.t_state)),
        "missing": int(np.isnan(recording.qpos).sum()),
        "joints": recording.joint_names,
        "actuators": recording.actuator_names,
    }
    print_result(result, as_json=args.json)
