"""Follow a mechanism in a video of your own."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Follow a mechanism in a video: keypoints, pivot and angles, with their uncertainty, and what a free swing tells.

    For instance: keycld track swing.mov --mechanism examples/apple_pendulum.py --out data/swing

    Attributes:
        video: Video file (.mp4, .mov, .mkv) of the mechanism, seen along its axis.
        mechanism: Python file with a variable `mechanism`, a keycld_envs.Mechanism.
        out: Folder to create: a recording, with overlay.mp4, report.html and track.json.
        marks: Pivot and keypoints in one frame, column and row of each in pixels; a chain of rods needs them, one rod
            alone is found without.
        frame: Index of that frame.
        fps: Frames per second, in place of the file's time stamps.
        licence: Of the video.
        origin: Where it comes from; by default the file's name.
        seed: Of the random search for what turns, and of intervals.
        json: Print one JSON object.
    """

    video: Positional[Path]
    mechanism: Path
    out: Path
    marks: tuple[tuple[float, float], ...] = ()
    frame: int = 0
    fps: float | None = None
    licence: str = ""
    origin: str = ""
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Read, follow, study, write, and say what was found."""
    import numpy as np

    from keycld_control.tracking.save import check_out, recording_of, save
    from keycld_control.tracking.summary import summary
    from keycld_envs.checks import check_whole
    from keycld_envs.mechanism_file import read_mechanism
    from keycld_envs.progress import progress
    from keycld_model.tracking import read, steps, track
    from keycld_model.tracking.pendulum import study_pendulum
    from keycld_model.tracking.pendulum.study import CANDIDATES

    check_whole("seed", args.seed, 0, 2**63)
    mechanism = read_mechanism(args.mechanism)
    check_out(args.out, args.video)
    with progress("Reading", total=1) as advance:
        film = read(args.video, mechanism, args.fps)
        advance()
    marks = np.array(args.marks) if args.marks else None
    with progress("Following", total=steps(film, mechanism)) as advance:
        found = track(film, mechanism, args.seed, advance, marks, args.frame)
    study = None
    if mechanism.num_keypoints == 1 and not mechanism.num_actions:
        with progress("Predicting", total=len(CANDIDATES)) as advance:
            study = study_pendulum(film.times, found.angles[:, 0], args.seed, advance)
    numbers = summary(found, study)
    recording = recording_of(found, args.out.name, args.licence, args.origin)
    with progress("Writing", total=len(film)) as advance:
        save(args.out, recording, found, study, numbers, advance)
    shown = {name: value for name, value in numbers.items() if args.json or name != "candidates"}
    print_result({"recording": args.out, **shown}, as_json=args.json)
