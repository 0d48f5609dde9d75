"""A recording of each of several logs."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from keycld_control.cli._import_options import Args
from keycld_control.cli._pairs import pairs

if TYPE_CHECKING:
    from keycld_envs.recordings import Recording
    from keycld_envs.recordings.importers import Columns


def import_logs(args: Args) -> dict[str, Any]:
    """Read all before the first is written, and say what was read.

    Args:
        args: options of `keycld import`.

    Raises:
        InputError: if a file cannot be read, or a folder exists.
    """
    from keycld_envs.errors import InputError
    from keycld_envs.progress import progress
    from keycld_envs.recordings import write_recording

    folders = [args.out] if len(args.files) == 1 else [args.out / file.stem for file in args.files]
    if twice := [folder for folder in folders if folders.count(folder) > 1]:
        raise InputError(f"Several files would become {twice[0]}; rename one of them.")
    recordings = []
    with progress("Importing", total=len(folders)) as advance:
        for file, folder in zip(args.files, folders, strict=True):
            recordings.append(_read(args, file, folder.resolve().name))
            advance()
    if there := [folder for folder in folders if folder.is_dir() and any(folder.iterdir())]:
        raise InputError(f"{there[0]} exists and is not empty; choose another folder, or remove it.")
    for folder, recording in zip(folders, recordings, strict=True):
        write_recording(folder, recording)
    results = [_summary(*pair) for pair in zip(folders, recordings, strict=True)]
    if len(results) == 1:
        return results[0]
    if args.json:
        return {"recordings": results}
    return {str(r["recording"]): f"{r['samples']} samples, {r['seconds']:.4g} s" for r in results}


def columns_of(args: Args, time: str, known: dict[str, str]) -> "Columns":
    """What the columns are, by the options of `keycld import`.

    Args:
        args: these options.
        time: column of the clock.
        known: units of columns that the file itself tells.
    """
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


def about_of(args: Args) -> dict[str, Any]:
    """Licence, origin and environment of the data, by the options of `keycld import`."""
    from keycld_envs import resolve_env_id

    system = None if args.system is None else resolve_env_id(args.system)
    return {"licence": args.licence, "origin": args.origin, "system": system}


def _read(args: Args, file: Path, name: str) -> "Recording":
    """One file as a recording."""
    from keycld_envs.errors import InputError
    from keycld_envs.recordings.importers import assemble, read_log

    if args.time is None or not args.joint:
        raise InputError(f"{file} is a log; name its columns with --time COLUMN and --joint JOINT=COLUMN.")
    table, known = read_log(file, args.columns or None, drop_truncated_end=args.drop_truncated_end)
    return assemble(table, columns_of(args, args.time, known), name, **about_of(args))


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
