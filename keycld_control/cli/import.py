"""Make a recording of a CSV, JSON or MATLAB file, or a data set of a video."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, configure

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Film:
    """How to make a data set of a video.

    Attributes:
        mechanism: of a video: Python file that declares the mechanism; its fixed pivot gets the place that it says.
        crop: of a video: square part to keep, LEFT TOP SIDE in pixels; by default, all that moves.
        pivot: of a video: column and row of the mechanism's fixed pivot, pixels; the square is laid around it.
        size: of a video: width and height of the frames to write, pixels.
        frames: of a video: frames of each recording that it is cut into.
        every: of a video: keep one in so many frames.
        fps: of a video: frames per second, in place of the file's time stamps (slow motion).
    """

    mechanism: Path | None = None
    crop: tuple[int, int, int] | None = None
    pivot: tuple[float, float] | None = None
    size: int = 64
    frames: int = 50
    every: int = 1
    fps: float | None = None


@configure(OmitArgPrefixes)
@dataclass(frozen=True)
class Args:
    """Make a recording of a CSV, JSON or MATLAB file: say which column is what. Or a data set of a video.

    For instance: keycld import log.csv --out data/log --time t --joint hinge=angle --action motor=torque
    or: keycld import swing.mp4 --out data/swing --mechanism pendulum.py --pivot 640 90

    Attributes:
        file: CSV file with a header, JSON log (.json, .jsonl), MATLAB file (.mat) up to version 7, file of EPOS
            Studio's recorder, or video (.mp4, .mov, .mkv, ...).
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
        film: Of videos.
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
    hold: bool = False
    drop_truncated_end: bool = False
    licence: str = ""
    origin: str = ""
    system: str | None = None
    film: Film = Film()
    json: bool = False


def run(args: Args) -> None:
    """Read, write, and say what was read."""
    from keycld_envs.recordings.importers import film

    result = _of_video(args) if args.file.suffix.lower() in film.SUFFIXES else _of_log(args)
    print_result(result, as_json=args.json)


def _of_log(args: Args) -> dict[str, Any]:
    """One recording of joints."""
    import numpy as np

    from keycld_control.cli._pairs import pairs
    from keycld_envs import InputError, resolve_env_id
    from keycld_envs.recordings import write_recording
    from keycld_envs.recordings.importers import Columns, assemble, read_log

    if args.time is None or not args.joint:
        raise InputError(f"{args.file} is a log; name its columns with --time COLUMN and --joint JOINT=COLUMN.")
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
    return {
        "recording": args.out,
        "samples": len(recording.t_state),
        "seconds": float(np.ptp(recording.t_state)),
        "missing": int(np.isnan(recording.qpos).sum()),
        "joints": recording.joint_names,
        "actuators": recording.actuator_names,
    }


def _of_video(args: Args) -> dict[str, Any]:
    """A data set of frames."""
    import numpy as np

    from keycld_envs.errors import InputError
    from keycld_envs.mechanism_file import read_mechanism
    from keycld_envs.progress import progress
    from keycld_envs.recordings.importers import film

    given = args.film
    cut = film.Cut(given.size, given.frames, given.every, args.licence, args.origin)
    mechanism = None if given.mechanism is None else read_mechanism(given.mechanism)
    fixed = mechanism is not None and (any(rod.start is None for rod in mechanism.rods) or bool(mechanism.sliders))
    if fixed and given.crop is None and given.pivot is None:
        raise InputError(
            f"{given.mechanism} declares a fixed pivot; say where it is in {args.file} with --pivot COLUMN ROW, or "
            "what to keep with --crop LEFT TOP SIDE."
        )
    with progress("Looking", total=1) as advance:
        look = film.look_at(args.file, given.fps)
        advance()
    place = (0.0, 0.0) if mechanism is None else mechanism.pivot
    square = film.Square(*given.crop) if given.crop else film.square_around(look, place, given.pivot)
    with progress("Cutting", total=len(look.times)) as advance:
        number = film.write_parts(args.file, args.out, look, square, advance, cut)
    return {
        "data": args.out,
        "recordings": number,
        "frames": cut.frames,
        "frames_per_second": round(float(1 / (cut.every * np.median(np.diff(look.times)))), 3),
        "used": number * cut.frames * cut.every / len(look.times),
        "crop": (square.left, square.top, square.side),
        "pivot": None if given.pivot is None else square.units(*given.pivot),
    }
