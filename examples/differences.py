"""Train a system with the default preset changed in one thing at a time towards the paper's, and compare.

    keycld collect acrobot --episodes 500 --steps 50 --out data/acrobot --seed 1
    python examples/differences.py --system acrobot --data data/acrobot --out runs/differences

With few recordings, what was tried to learn less of them by heart:

    python examples/differences.py --system acrobot --data data/acrobot --out runs/few --recordings 55 --only default \
        "short distillations" "alternating distillations" "linear forces" "priced forces, no lean"

One row takes about as long as training the default; widths and full resolution several times that. Rows that are done
are not trained again.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro

from keycld_envs import resolve_env_id, system_of
from keycld_envs.recordings import read_dataset
from keycld_model import WorldModel
from keycld_model.config import ModelConfig
from keycld_model.evaluation import evaluate
from keycld_model.training import PRESETS, Preset, TrainingError, train
from keycld_model.training.distil import Distil
from keycld_model.training.fit import FitTrajectories
from keycld_model.training.presets import by_gradient_descent, with_networks
from keycld_model.training.stage import Stage

DEFAULT = PRESETS["default"]
TESTED = 100
"""Recordings that score a training with few."""


def stages(change: Callable[[Stage], Stage]) -> Preset:
    """Other stages."""
    return replace(DEFAULT, stages=tuple(change(stage) for stage in DEFAULT.stages))


def alternating() -> Preset:
    """Three short first distillations with a fit after each, then a shorter last one."""
    first, fit, last, end = DEFAULT.stages[5:]
    rounds = (replace(first, steps=600), fit) * 3
    return replace(DEFAULT, stages=(*DEFAULT.stages[:5], *rounds, replace(last, steps=2700), end))


def distillations(first: int, last: int) -> Preset:
    """Of fewer steps."""
    return stages(lambda s: replace(s, steps=first if s.steps == 1000 else last) if isinstance(s, Distil) else s)


def linear_forces(stage: Stage) -> Stage:
    """Nothing for the networks of V and g."""
    return replace(stage, steps=0) if isinstance(stage, FitTrajectories) else stage


def priced_forces(stage: Stage) -> Stage:
    """Motors pay for what they act on to the end, and keypoints do not lean."""
    return replace(stage, acting=False) if isinstance(stage, FitTrajectories) else stage


VARIANTS: dict[str, Preset] = {
    "default": DEFAULT,
    "gaussians of .1 alone, no rods": with_networks(DEFAULT, gaussian_widths=(0.1,), segment_widths=()),
    "no background": with_networks(DEFAULT, background=False),
    "no saliency": with_networks(DEFAULT, saliency=0.0),
    "paper's optimiser, Adam 3e-4": stages(lambda s: replace(s, learning_rate=3e-4, one_cycle=False, clip=None)),
    "no Gauss-Newton": by_gradient_descent(DEFAULT),
    "V, g without linear terms": with_networks(DEFAULT, linear=False),
    "paper's loss and optimiser": PRESETS["joint"],
    "32 channels, 8 groups": with_networks(DEFAULT, width=32, groups=8),
    "64 x 64 images": with_networks(DEFAULT, folding=1),
    "short distillations": distillations(400, 1200),
    "alternating distillations": alternating(),
    "linear forces": stages(linear_forces),
    "priced forces, no lean": stages(priced_forces),
}


@dataclass(frozen=True)
class Args:
    """What to compare.

    Attributes:
        data: Recordings to train with.
        out: Folder for checkpoints and results.
        system: Short name or environment id.
        only: Names of rows; all by default.
        recordings: Train with the first so many, and score on the last 100; by default with all, and on those held out.
        seed: Seed of the training.
    """

    data: Path
    out: Path
    system: str = "acrobot"
    only: tuple[str, ...] = ()
    recordings: int | None = None
    seed: int = 0


def measure(args: Args, name: str) -> dict[str, Any]:
    """Train one row and score it on the recordings held out."""
    folder = args.out / args.system / name.replace(" ", "-").replace(",", "")
    done = folder / "row.json"
    if done.is_file():
        return json.loads(done.read_text(encoding="utf-8"))
    dataset, system, preset = read_dataset(args.data), resolve_env_id(args.system), VARIANTS[name]
    tested = dataset
    if args.recordings is not None:
        tested = replace(dataset, recordings=dataset.recordings[-TESTED:])
        dataset = replace(dataset, recordings=dataset.recordings[: args.recordings])
    config = ModelConfig.of(dataset, system_of(system).mechanism, system, preset.networks)
    start = time.monotonic()
    row: dict[str, Any] = {"row": name}
    try:
        result = train(dataset, config, folder, preset, args.seed)
        model = WorldModel.load(result.folder)
        score = evaluate(model, tested)
        row |= {
            "vpt": score.vpt_fraction,
            "vpt_interval": score.vpt_interval,
            "circular_r2": min(score.circular_r2.values()) if score.circular_r2 else None,
            "reconstruction_mse": score.reconstruction_mse,
            "masses": model.masses.tolist(),
        }
    except TrainingError as error:  # keypoints that collapse are a result, too
        row["failure"] = str(error)
    row["seconds"] = round(time.monotonic() - start)
    folder.mkdir(parents=True, exist_ok=True)
    done.write_text(json.dumps(row), encoding="utf-8")
    return row


if __name__ == "__main__":
    args = tyro.cli(Args)
    for name in args.only or VARIANTS:
        print(json.dumps(measure(args, name)), flush=True)
