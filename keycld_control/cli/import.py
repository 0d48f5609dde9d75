"""Make recordings of logs (CSV, JSON, MATLAB, MCAP), of a video, or of a data set of LeRobot or Minari."""

from keycld_control.cli._import_options import Args
from keycld_control.cli._output import print_result


def run(args: Args) -> None:
    """Read, write, and say what was read."""
    from keycld_envs.errors import InputError
    from keycld_envs.recordings.importers.film import is_video

    if not args.files:
        raise InputError("There is no file to import; name one, or several.")
    alone = [file for file in args.files if file.is_dir() or is_video(file)]
    if alone and len(args.files) > 1:
        raise InputError(f"{alone[0]} is a data set of its own; import it alone.")
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
