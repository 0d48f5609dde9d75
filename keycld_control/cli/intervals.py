"""Say how far the masses and lengths of a world model may be off."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Print 90 % intervals of masses and lengths, and add them to a model that holds none.

    For instance: keycld intervals runs/arm --data data/arm --out runs/arm-known. In Python,
    `WorldModel.intervals(at=...)` has those of V and g, too.

    Attributes:
        checkpoint: Path of a checkpoint, or a system's name for the shipped weights.
        data: Folder of recordings on which to measure the intervals anew; with it, name --out.
        out: Folder for the same model with these intervals.
        json: Print one JSON object.
    """

    checkpoint: Positional[str]
    data: Path | None = None
    out: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Read or measure, store, and print."""
    from keycld_envs.errors import InputError
    from keycld_envs.recordings import read_dataset
    from keycld_model import WorldModel

    if (args.data is None) != (args.out is None):
        raise InputError("--data and --out go together; name the recordings, and where to write the model.")
    if args.out is not None and args.out.exists() and (not args.out.is_dir() or any(args.out.iterdir())):
        raise InputError(f"--out: {args.out} exists already; choose another folder or remove it.")
    model = WorldModel.load(args.checkpoint)
    if args.data is not None and args.out is not None:
        from keycld_model.training.covariance import with_uncertainty

        model = with_uncertainty(model, read_dataset(args.data))
        model.save(args.out)
    found = model.intervals()
    print_result(
        {"system": model.system, "masses": found.masses, "lengths": found.lengths, "checkpoint": args.out},
        as_json=args.json,
    )
