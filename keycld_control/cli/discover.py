"""Find the structure of a mechanism in recordings of it: keypoints, rods and sliders, as a file to train with."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Find how many parts move, on which hinges and rails, from frames alone; write the file that declares it.

    Structures are ranked by what they leave unexplained in held-out frames, and a price for each degree of freedom.
    The camera must stand still, and look along the hinges.

    For instance: keycld discover data/my_arm --out my_arm.py, then: keycld check my_arm.py --data data/my_arm

    Attributes:
        data: Folder of recordings with frames.
        out: Python file to write.
        picture: Picture of the candidates to write (.png, .jpg); by default beside the file.
        json: Print one JSON object.
    """

    data: Positional[Path]
    out: Path
    picture: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Find, draw, write, and print the ranking."""
    import sys

    from keycld_control.discovered import draw, table, write_file
    from keycld_envs.errors import InputError
    from keycld_envs.progress import progress
    from keycld_envs.recordings import read_dataset
    from keycld_model.discovery import declare, discover, doubts, read_frames, steps

    picture = args.picture or args.out.with_suffix(".png")
    if args.out.suffix != ".py":
        raise InputError(f"--out is {args.out}; a mechanism's file must end in .py.")
    if picture.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"--picture is {picture}; a picture must end in .png or .jpg.")
    if args.out.exists():
        raise InputError(f"{args.out} exists; choose another name, or remove it.")
    dataset = read_dataset(args.data)
    frames = read_frames(dataset)
    with progress("Discovering", total=steps()) as advance:
        found = discover(frames, advance)
    num_actions = len(dataset.recordings[0].actuator_names)
    try:
        declared = declare(found.best.parts, frames, num_actions)
    except InputError:
        draw(picture, found, None)
        raise
    draw(picture, found, declared)
    write_file(args.out, args.data, declared.mechanism, found)
    doubtful = doubts(found)
    ranking = table(found.ranked)
    result = {"file": args.out, "picture": picture, "degrees_of_freedom": declared.mechanism.degrees_of_freedom}
    if args.json:
        print_result(
            result | {"mechanism": declared.mechanism.to_dict(), "ranked": ranking, "doubts": doubtful}, as_json=True
        )
    else:
        rows = {
            f"{each['score']:.3f}": f"{each['structure']} ({each['unexplained']:.3f} unexplained)" for each in ranking
        }
        print_result(rows | result | {"next": f"keycld check {args.out} --data {args.data}"}, as_json=False)
    for sentence in doubtful:
        print(f"keycld: warning: {sentence}", file=sys.stderr)
