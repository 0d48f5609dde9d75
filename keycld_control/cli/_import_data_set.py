"""Recordings of a data set of LeRobot or Minari."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from keycld_control.cli._import_logs import about_of, columns_of
from keycld_control.cli._import_options import Args


def import_data_set(path: Path, args: Args) -> dict[str, Any]:
    """Read, write, and say what was read."""
    from keycld_envs.errors import InputError
    from keycld_envs.files import atomic_folder
    from keycld_envs.progress import progress
    from keycld_envs.recordings import write_recording
    from keycld_envs.recordings.importers import expand_units, open_data_set

    data = open_data_set(path, args.camera)
    about = about_of(args)
    recording, samples = None, 0
    try:
        with atomic_folder(args.out) as folder, progress("Import", data.length) as advance:
            for episode in data:
                columns = None
                if args.joint or args.unit or args.time:
                    columns = columns_of(args, args.time or episode.columns.time, {})
                    if not args.joint:
                        columns = replace(episode.columns, time=columns.time, units=columns.units)
                    columns = replace(columns, units=expand_units(columns.units, list(episode.table.columns)))
                recording = episode.recording(columns, **about)
                write_recording(folder / episode.folder_name(recording.id), recording)
                samples += recording.num_frames if recording.t_state is None else len(recording.t_state)
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
