"""Arms of one to three links with drawn lengths, masses and motors: how well is each predicted after training?

    python examples/drawn_arms.py --out runs/arms --arms 20 --recordings 60 200 500

Every arm is recorded, learned by a recipe, and asked to predict recordings that it has not seen. An arm takes four to
fifteen minutes of one core; what is done is not done again, so the same command goes on where it was stopped. With
`--intervals`, 90 % intervals of its masses, lengths, V and g are compared with the simulator's, which takes a third as
long again.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from keycld_control.benchmarks.intervals.coverage import compare, coverage
from keycld_control.benchmarks.intervals.mechanisms import drawn_arm
from keycld_control.benchmarks.intervals.truth import truth_of
from keycld_control.plain_json import write_json
from keycld_envs import System, register
from keycld_envs.collect import CollectSettings, collect
from keycld_envs.errors import InputError
from keycld_envs.progress import progress
from keycld_envs.recordings import Dataset, read_dataset
from keycld_envs.recordings.weaknesses import weaknesses
from keycld_model import WorldModel
from keycld_model.config import ModelConfig
from keycld_model.evaluation import evaluate
from keycld_model.training import PRESETS, TrainingError, train
from keycld_model.training.covariance import with_uncertainty

GOOD = 0.9
"""Of the time until a recording ends, predicted."""


@dataclass(frozen=True)
class Args:
    """Train models of drawn arms.

    Attributes:
        out: folder for recordings and models.
        arms: how many; of one, two and three links in turn.
        recordings: of 50 frames, to learn from.
        preset: recipe.
        held_out: recordings of each arm to predict.
        seed: of the first arm.
        intervals: count how many 90 % intervals of each arm hold the truth, too.
    """

    out: Path
    arms: int = 20
    recordings: tuple[int, ...] = (200,)
    preset: str = "quick"
    held_out: int = 50
    seed: int = 0
    intervals: bool = False


def measure(system: System, recordings: int, args: Args) -> dict[str, Any]:
    """Record, train, predict; a training that ends says why."""
    env_id = f"DrawnArms/{system.name}-v0"
    register(system, env_id)
    folder = args.out / system.name
    training, held_out = folder / f"train-{recordings}", folder / "held-out"
    collect(training, CollectSettings(env_id, seed=args.seed), recordings)
    collect(held_out, CollectSettings(env_id, seed=args.seed + 1_000_000), args.held_out)
    dataset, started = read_dataset(training), time.process_time()
    config = ModelConfig.of(dataset, system.mechanism, env_id, PRESETS[args.preset].networks)
    found: dict[str, Any] = {"arm": system.name, "recordings": recordings, "preset": args.preset}
    found["weaknesses"] = list(weaknesses(dataset, system))
    run = folder / f"{args.preset}-{recordings}"
    try:
        train(dataset, config, run, args.preset, seed=0)
    except TrainingError as error:
        return {**found, "failure": str(error), "vpt": 0.0}
    seconds = round(time.process_time() - started)
    model = WorldModel.load(str(run))
    score = evaluate(model, read_dataset(held_out))
    return {
        **found,
        "cpu_s": seconds,
        "vpt": score.vpt_fraction,
        "interval": score.vpt_interval,
        "r2": score.circular_r2,
        **(covered(model, dataset, system, args.seed) if args.intervals else {}),
    }


def covered(model: WorldModel, dataset: Dataset, system: System, seed: int) -> dict[str, Any]:
    """Of each quantity, how many intervals hold the truth, and of how many."""
    try:
        inside = compare(with_uncertainty(model, dataset), truth_of(system), seed).inside
    except InputError as error:
        return {"no_intervals": str(error)}
    return {"intervals": {name: [int(each.sum()), len(each)] for name, each in inside.items()}}


def main(args: Args) -> None:
    """Print a line per model, then how many are good."""
    found = []
    with progress("Arms", total=args.arms * len(args.recordings)) as advance:
        for i in range(args.arms):
            system = drawn_arm(1 + i % 3, args.seed + i // 3)
            for recordings in args.recordings:
                file = args.out / system.name / f"{args.preset}-{recordings}.json"
                if not file.is_file():
                    write_json(file, measure(system, recordings, args))
                found.append(json.loads(file.read_text(encoding="utf-8")))
                advance()
    for each in found:
        joints = each.get("r2") or {}
        worst = min(joints.values(), default=float("nan"))
        scores = f"VPT {each['vpt']:.3f}  R2 {worst:.4f}"
        print(f"{each['arm']:>10} {each['recordings']:>4} {scores}  {each.get('failure', '')}")
    for recordings in args.recordings:
        good = [each["vpt"] >= GOOD for each in found if each["recordings"] == recordings]
        print(f"{recordings} recordings: {sum(good)} of {len(good)} arms are predicted for {GOOD:g} of the time")
        counted = [each["intervals"] for each in found if each["recordings"] == recordings and "intervals" in each]
        if counted:
            sums = [np.sum(list(counts.values()), axis=0) for counts in counted]
            inside = [np.arange(of) < held for held, of in sums]
            share = coverage("90 % intervals", inside, args.seed)
            print(f"{share.reached:.3f} {share.interval} of {share.details['intervals']} intervals hold the truth")


if __name__ == "__main__":
    main(tyro.cli(Args))
