"""How much sooner than the paper's training ours predicts as well."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld_envs import resolve_env_id, system_of
from keycld_envs.recordings import Dataset
from keycld_model.config import ModelConfig
from keycld_model.modules import Parts
from keycld_model.training import PRESETS, TrainingData
from keycld_model.training.log import NAME
from keycld_model.training.step import make_step

STEPS = 5
"""That are timed, after one that compiles; the median counts."""


def speed(log: Path, end: Mapping[str, Any], wanted: float, step: float) -> dict[str, Any]:
    """Seconds until validation VPT reached that of the paper, beside seconds of the paper's 45,000 steps.

    Args:
        log: folder of the training's log, whose scores come from states fitted to keypoints alone.
        end: "seconds" and "validation_vpt" of the finished model, whose states are fitted to pixels, too.
        wanted: the paper's VPT.
        step: `reference_step`.

    Returns:
        "seconds" at the end of the first stage that reached it, or of the training, None if none did;
        "reference_step", s; "reference", s, of all its steps; "times", the ratio.
    """
    entries = [json.loads(line) for line in (log / NAME).read_text(encoding="utf-8").splitlines()]
    reached = [e["seconds"] for e in (*entries, end) if (e.get("validation_vpt") or 0.0) >= wanted]
    whole = step * PRESETS["paper"].steps
    seconds = reached[0] if reached else None
    return {
        "seconds": seconds,
        "wanted": wanted,
        "reference_step": step,
        "reference": whole,
        "times": None if seconds is None else whole / seconds,
    }


def reference_step(system: str, dataset: Dataset, steps: int = STEPS) -> float:
    """Seconds of one training step with the exact networks, batch and loss of the paper's table 2, in this process."""
    preset, name = PRESETS["paper"], resolve_env_id(system)
    (stage,) = preset.stages
    config = ModelConfig.of(dataset, system_of(name).mechanism, name, preset.networks)
    parts, data = Parts(config), TrainingData.from_dataset(dataset, preset.length)
    variables = jax.tree.map(jnp.asarray, parts.initial(0))
    trained = {key: variables[key] for key in stage.trained}
    optimiser = stage.optimiser()
    state, step, seconds = optimiser.init(trained), make_step(parts, stage, optimiser), []
    for i in range(steps + 1):
        batch = stage.draw({}, data, np.random.default_rng(i))
        start = time.perf_counter()
        trained, state, metrics = step(trained, {}, state, batch)
        jax.block_until_ready(metrics)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:]))
