"""Options of `keycld import`."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, configure


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
    """Make a recording of a log, a data set of a video, or recordings of a data set: say which column is what.

    For instance: keycld import log.csv --out data/log --time t --joint hinge=angle --action motor=torque

    Or all at once, a recording of each in data/logs: keycld import logs/*.csv --out data/logs --time t ...

    Or a video: keycld import swing.mp4 --out data/swing --mechanism pendulum.py --pivot 640 90

    Attributes:
        files: CSV file with a header, JSON log (.json, .jsonl), MATLAB file (.mat) up to version 7, file of EPOS
            Studio's recorder, MCAP file (.mcap), or several alike; a video (.mp4, .mov, .mkv, ...); or the folder of a
            data set of LeRobot v3 or Minari.
        out: Folder to create; of several files, the one that their recordings are put into, each named like its file.
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
        film: Of videos.
        json: Print one JSON object.
    """

    files: Positional[tuple[Path, ...]]
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
    film: Film = Film()
    json: bool = False
