"""Score a world model on recordings."""

from dataclasses import asdict, dataclass
from pathlib import Path

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Score a world model on any data set of recordings; of its own training set, only the held-out part counts.

    Attributes:
        checkpoint: Path of a checkpoint, or a system's name for the shipped weights.
        data: Folder of recordings.
        context: Frames that each prediction starts from.
        frames: Recordings are cut into sequences of at most this many frames.
        video: Clip of six of the predictions beside what was recorded, .mp4 or .gif.
        json: Print one JSON object.
    """

    checkpoint: Positional[str]
    data: Path
    context: int = 5
    frames: int = 50
    video: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Evaluate and print the scores, and 90 % intervals of masses and lengths if the model knows them."""
    from keycld_envs.recordings import read_dataset
    from keycld_model import WorldModel
    from keycld_model.evaluation import evaluate

    if args.video is not None:
        from keycld_control.video import check_clip_path

        check_clip_path(args.video)
    model, dataset = WorldModel.load(args.checkpoint), read_dataset(args.data)
    scores = evaluate(model, dataset, args.context, args.frames)
    if args.video is not None:
        from keycld_control.prediction_clip import film_predictions

        film_predictions(model, dataset, args.video, args.context, args.frames)
    known = None if model.uncertainty is None else model.intervals()
    intervals = {name: None if known is None else getattr(known, name) for name in ("masses", "lengths")}
    print_result({**asdict(scores), **{f"{k}_interval": v for k, v in intervals.items()}}, as_json=args.json)
