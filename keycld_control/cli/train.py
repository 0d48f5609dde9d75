"""Train a world model on recordings."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Train a world model. Run again with the same settings, it continues where it stopped.

    Attributes:
        system: Short name (`keycld systems` lists them), environment id, module:id of your own, a Python file that
            declares a system or a mechanism (`keycld new` writes one), or a JSON file with a mechanism's declaration.
        data: Folder of recordings.
        out: Folder for the checkpoint and the log.
        preset: Recipe; `keycld presets` lists them.
        learning_rate_scale: Factor on the learning rates of all stages.
        width: Channels of estimator and renderer at their finest level, a multiple of 4; by default the recipe's.
        hidden: Width of the hidden layers of potential energy and actuators; by default the recipe's.
        validation: Fraction of the recordings held out.
        seed: Seed of initialisation and batches.
        log: Also show curves in "tensorboard", "wandb" or "trackio", which need the extra of that name; a page,
            report.html, is written beside the run in any case.
        json: Print one JSON object.
    """

    system: Positional[str]
    data: Path
    out: Path
    preset: str = "default"
    learning_rate_scale: float = 1.0
    width: int | None = None
    hidden: int | None = None
    validation: float = 0.1
    seed: int = 0
    log: Literal["tensorboard", "wandb", "trackio"] | None = None
    json: bool = False


def run(args: Args) -> None:
    """Train and print the summary."""
    from keycld_control.cli._declared import declared
    from keycld_control.runs.watching import watching
    from keycld_envs import system_of
    from keycld_envs.errors import InputError
    from keycld_envs.recordings import read_dataset
    from keycld_envs.recordings.weaknesses import weaknesses
    from keycld_envs.registration import same_system
    from keycld_model.config import ModelConfig
    from keycld_model.training import PRESETS, Preset, train
    from keycld_model.training.presets import with_networks, with_rate

    if args.preset not in PRESETS:
        raise InputError(f"There is no preset {args.preset!r}; there are {', '.join(PRESETS)}.")
    groups = PRESETS[args.preset].networks.groups
    if args.width is not None and args.width % groups:
        raise InputError(f"--width is {args.width}; it must be a multiple of {groups}, such as {groups * 4}.")
    name, mechanism = declared(args.system)
    dataset = read_dataset(args.data)
    if name is not None and dataset.system is not None and not same_system(dataset.system, name):
        raise InputError(f"{args.data} records {dataset.system}, not {name}; name the system that was recorded.")
    recipe: str | Preset = args.preset
    sizes = {key: size for key in ("width", "hidden") if (size := getattr(args, key)) is not None}
    if sizes or args.learning_rate_scale != 1:
        recipe = with_rate(with_networks(PRESETS[args.preset], **sizes), args.learning_rate_scale)
    networks = recipe.networks if isinstance(recipe, Preset) else PRESETS[recipe].networks
    config = ModelConfig.of(dataset, mechanism, name, networks)
    weak: list[str] = []

    def warn(sentence: str) -> None:
        print(f"keycld: warning: {sentence}", file=sys.stderr, flush=True)
        weak.append(sentence)

    def look() -> None:
        for sentence in weaknesses(dataset, None if name is None else system_of(name), mechanism):
            warn(sentence)

    about = {"system": args.system, "preset": args.preset, "seed": args.seed, "data": str(args.data)}
    steps = PRESETS[args.preset].steps
    with watching(args.out, about, args.log, steps, lambda: dataset.split(args.validation)[1]) as watchers:
        result = train(dataset, config, args.out, recipe, args.seed, args.validation, watchers=watchers, on_start=look)
    if result.spare is not None:
        warn(
            f"Keypoint {result.spare} follows no part of its own, while something else moves that no keypoint draws; "
            "begin again with another --seed, or show that part larger, in another colour, or in larger motions."
        )
    summary = {
        "system": name,
        "checkpoint": str(result.folder),
        "steps": result.steps,
        "seconds": round(result.seconds, 1),
        "validation_vpt": result.validation_vpt,
        "weaknesses": weak,
        "seed": args.seed,
    }
    print_result(summary, as_json=args.json)
