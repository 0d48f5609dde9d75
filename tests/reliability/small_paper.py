"""`keycld paper` with small data sets and short trainings, into a folder: python small_paper.py FOLDER."""

import sys
from dataclasses import replace
from pathlib import Path

import jax

sys.path.insert(0, str(Path(__file__).parent.parent / "model"))
from sharded import PRESET  # pyright: ignore[reportMissingImports]
from swinging import random_parameters  # pyright: ignore[reportMissingImports]

from keycld_control.paper import recordings, work
from keycld_control.paper.plan import Training
from keycld_model.modules import Parts
from keycld_model.training import PRESETS, loop

if __name__ == "__main__":
    jax.config.update("jax_disable_most_optimizations", True)
    for name, part in recordings.PARTS.items():
        recordings.PARTS[name] = replace(part, episodes=6, steps=12)
    PRESETS["nc"] = replace(PRESET, networks=replace(PRESET.networks, motion="unconstrained"))
    setattr(Parts, "initial", lambda parts, seed: random_parameters(parts.config, seed))  # noqa: B010
    loop.SAVE_EVERY, loop.COLLAPSED = 0.0, 0.0
    work.work_off(work.Work(Path(sys.argv[1])), [Training("pendulum", "nc", seed) for seed in range(2)])
