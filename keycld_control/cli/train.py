"""Train a world model on recordings."""

from dataclasses import dataclass
from pathlib import Path

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
        validation: Fraction of the recordings held out.
        seed: Seed of initialisation and batches.
        json: Print one JSON object.
    """

    system: Positional[str]
    data: Path
    out: Path
    preset: str = "default"
    validation: float = 0.1
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Train and print the summary."""
    from keycld_control.cli._declared import declared
    from keycld_envs.errors import InputError
    from keycld_envs.recordings import read_dataset
    from keycld_envs.registration import same_system
    from keycld_model.config import ModelConfig
    from keycld_model.training import PRESETS, train

    if args.preset not in PRESETS:
        raise InputError(f"There is no preset {args.preset!r}; there are {', '.join(PRESETS)}.")
    name, mechanism = declared(args.system)
    dataset = read_dataset(args.data)
    if name is not None and dataset.system is not None and not same_system(dataset.system, name):
        raise InputError(f"{args.data} records {dataset.system}, not {name}; name the system that was recorded.")
    config = ModelConfig.of(dataset, mechanism, name, PRESETS[args.preset].networks)
    result = train(dataset, config, args.out, args.preset, args.seed, args.validation)
    summary = {
        "system": name,
        "checkpoint": str(result.folder),
        "steps": result.steps,
        "seconds": round(result.seconds, 1),
        "validation_vpt": result.validation_vpt,
        "seed": args.seed,
    }
    print_result(summary, as_json=args.json)
