"""Train a system with the default preset changed in one thing at a time towards the paper's, and compare.

    keycld collect acrobot --episodes 500 --steps 50 --out data/acrobot --seed 1
    python examples/differences.py --system acrobot --data data/acrobot --out runs/differences

With few recordings, other rows: what was tried to learn less of them by heart.

    python examples/differences.py --system acrobot --data data/acrobot --out runs/few --recordings 55

One row takes about as long as training the default; widths and full resolution several times that. Rows that are done
are not trained again.
"""

import json
import sys
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
from keycld_model.training.fit import FitTrajectories
from keycld_model.training.presets import by_gradient_descent, with_networks
from keycld_model.training.stage import Stage

DEFAULT = PRESETS["default"]
TESTED = 100
"""Recordings that score a training with few."""


def stages(change: Callable[[Stage], Stage]) -> Preset:
    """Other stages."""
    return replace(DEFAULT, stages=tuple(change(stage) for stage in DEFAULT.stages))


def distillations(first: int, last: int, rounds: int = 1) -> Preset:
    """Of so many steps; the first one, and the fit after it, so many times."""
    *begin, distil, fit, again, end = DEFAULT.stages
    repeated = (replace(distil, steps=first), fit) * rounds
    return replace(DEFAULT, stages=(*begin, *repeated, replace(again, steps=last), end))


def constant_rate(stage: Stage) -> Stage:
    """The paper's, without clipping."""
    return replace(stage, learning_rate=3e-4, one_cycle=False, clip=None)


def sign_descent(stage: Stage) -> Stage:
    """What the optimiser of the reference's code is."""
    return replace(stage, forgetful=True)


def linear_forces(stage: Stage) -> Stage:
    """Nothing for the networks of V and g."""
    return replace(stage, steps=0) if isinstance(stage, FitTrajectories) else stage


def priced_forces(stage: Stage) -> Stage:
    """Motors pay for what they act on to the end, and keypoints do not lean."""
    return replace(stage, acting=False) if isinstance(stage, FitTrajectories) else stage


TOWARDS_PAPER: dict[str, Preset] = {
    "default": DEFAULT,
    "gaussians of .1 alone, no rods": with_networks(DEFAULT, gaussian_widths=(0.1,), segment_widths=()),
    "no background": with_networks(DEFAULT, background=False),
    "no saliency": with_networks(DEFAULT, saliency=0.0),
    "paper's optimiser, Adam 3e-4": stages(constant_rate),
    "sign descent": stages(sign_descent),
    "paper's optimiser, sign descent 3e-4": stages(lambda s: sign_descent(constant_rate(s))),
    "no Gauss-Newton": by_gradient_descent(DEFAULT),
    "V, g without linear terms": with_networks(DEFAULT, linear=False),
    "paper's loss and optimiser": PRESETS["joint"],
    "32 channels, 8 groups": with_networks(DEFAULT, width=32, groups=8),
    "64 x 64 images": with_networks(DEFAULT, folding=1),
}
WITH_FEW: dict[str, Preset] = {
    "default": DEFAULT,
    "short distillations": distillations(400, 1200),
    "alternating distillations": distillations(600, 2700, rounds=3),
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


def measure(args: Args, name: str, preset: Preset) -> dict[str, Any]:
    """Train one row and score it on the recordings held out."""
    folder = args.out / args.system / name.replace(" ", "-").replace(",", "")
    done = folder / "row.json"
    if done.is_file():
        return json.loads(done.read_text(encoding="utf-8"))
    dataset, system = read_dataset(args.data), resolve_env_id(args.system)
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
    rows = TOWARDS_PAPER if args.recordings is None else WITH_FEW
    if unknown := [name for name in args.only if name not in rows]:
        sys.exit(f"--only: there is no row {unknown[0]!r}; there are {', '.join(map(repr, rows))}.")
    for name in args.only or rows:
        print(json.dumps(measure(args, name, rows[name])), flush=True)
