"""Trains a little on all devices: python sharded.py FOLDER STAGES [ADDRESS PROCESS]; two processes share an address."""

import sys
from dataclasses import replace
from pathlib import Path

import jax
from swinging import CONFIG, dataset, random_parameters

from keycld_model.modules import Parts
from keycld_model.training import Preset, loop, train
from keycld_model.training.discover import Discover
from keycld_model.training.distil import Distil
from keycld_model.training.fit import FitTrajectories, FitWindows

PRESET = Preset(
    CONFIG.networks,
    (
        Discover(steps=4, batch=4, learning_rate=1e-3),
        FitWindows(steps=2, batch=4, learning_rate=1e-3, window=4),
        FitTrajectories(steps=2, batch=4, learning_rate=1e-3, restart=True),
        Distil(steps=3, batch=3, learning_rate=1e-3),  # an odd batch cannot be divided
    ),
)


def train_a_little(folder: Path, seed: int = 0, preset: Preset = PRESET) -> None:
    """From random weights, which take no time to draw; no scores."""
    setattr(Parts, "initial", lambda parts, seed: random_parameters(parts.config, seed))  # noqa: B010
    setattr(loop._Run, "_score", lambda *_, **__: float("nan"))  # noqa: B010
    loop.LOG_EVERY, loop.SAVE_EVERY, loop.COLLAPSED = 1, 0.0, 0.0
    train(dataset(), CONFIG, folder, preset, seed)


def train_one(folder: Path, seed: int) -> None:
    """One training of a sweep; its notes tell each beginning, and from where."""
    out = folder / str(seed)
    with (folder / f"{seed}.txt").open("a") as notes:
        notes.write("goes on\n" if (out / "state" / "checkpoint.json").is_file() else "begins\n")
    jax.config.update("jax_disable_most_optimizations", True)
    train_a_little(out, seed)


def main(folder: str, stages: str, *where: str) -> None:
    """Train, and say on what."""
    jax.config.update("jax_disable_most_optimizations", True)
    if where:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(where[0], num_processes=2, process_id=int(where[1]))
    train_a_little(Path(folder), preset=replace(PRESET, stages=PRESET.stages[: int(stages)]))
    print(f"{jax.process_count()} processes, {jax.device_count()} devices")


if __name__ == "__main__":
    main(*sys.argv[1:])
