"""Make recordings of logs (CSV, JSON, MATLAB, MCAP), of a video, or of a data set of LeRobot or Minari."""

from dataclasses import fields

from keycld_control.cli._import_options import Args, Film
from keycld_control.cli._output import print_result

WANTED = "name a log, a video, or the folder of a data set"
NO_RECORDINGS = {
    ".py": "a Python file",
    ".xml": "a mechanism's description (`keycld new --mjcf` takes it)",
    ".urdf": "a mechanism's description (`keycld new --mjcf` takes it)",
    ".png": "a picture",
    ".jpg": "a picture",
    ".jpeg": "a picture",
}
"""Suffix -> what such a file is, which can only be named by mistake."""


def run(args: Args) -> None:
    """Read, write, and say what was read."""
    from keycld_envs.errors import InputError
    from keycld_envs.recordings.importers.film import is_video

    if not args.files:
        raise InputError("There is no file to import; name one, or several.")
    if missing := [file for file in args.files if not file.exists()]:
        raise InputError(f"{missing[0]} does not exist; {WANTED}.")
    alone = [file for file in args.files if file.is_dir() or is_video(file)]
    if alone and len(args.files) > 1:
        raise InputError(f"{alone[0]} is a data set of its own; import it alone.")
    _check_options(args, bool(alone) and is_video(alone[0]))
    if others := [file for file in args.files if file.is_file() and file.suffix.lower() in NO_RECORDINGS]:
        raise InputError(f"{others[0]} is {NO_RECORDINGS[others[0].suffix.lower()]}, not a recording; {WANTED}.")
    if not alone:
        from keycld_control.cli._import_logs import import_logs

        result = import_logs(args)
    elif is_video(alone[0]):
        from keycld_control.cli._import_video import import_video

        result = import_video(alone[0], args)
    else:
        from keycld_control.cli._import_data_set import import_data_set

        result = import_data_set(alone[0], args)
    print_result(result, as_json=args.json)


def _check_options(args: Args, video: bool) -> None:
    """Refuse options of a video where none is imported, and those of columns with a video, which would do nothing."""
    from keycld_envs.errors import InputError
    from keycld_envs.recordings.importers.film import SUFFIXES

    of_video = [f.name for f in fields(Film) if getattr(args.film, f.name) != getattr(Film(), f.name)]
    of_columns = ("time", "joint", "velocity", "action", "action_time", "unit", "columns", "hold")
    given = [name for name in of_columns if getattr(args, name)] if video else of_video
    if given:
        option = f"--{given[0].replace('_', '-')}"
        kind = "is a video, which has no columns" if video else f"is no video by its name ({', '.join(SUFFIXES)})"
        raise InputError(f"{args.files[0]} {kind}; leave {option} out, or name another file.")
