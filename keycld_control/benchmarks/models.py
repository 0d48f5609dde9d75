"""How well the weights predict and see, and how long they took to train."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from keycld_control.benchmarks.figure import Figure
from keycld_control.benchmarks.weights import Weights
from keycld_envs import resolve_env_id
from keycld_envs.collect import CollectSettings, collect
from keycld_envs.progress import progress
from keycld_envs.recordings import Dataset, read_dataset
from keycld_model import WorldModel
from keycld_model.evaluation import Evaluation, evaluate

RECORDINGS, SAMPLE = 500, 40
"""Recordings of the paper's data set; how many are made to tell the speed where a data set exists already."""
VPT, CIRCULAR_R2, SECONDS = 0.98, 0.999, 600.0
CONTEXTS = (5, 2)
"""Frames that predictions start from: the default, and the fewest that show a velocity."""


def model_figures(weights: Weights, data: Path | None = None, workers: int = 2) -> Iterator[Figure]:
    """Valid prediction time, agreement of angles, and training time, on held-out recordings.

    Args:
        weights: what to measure.
        data: folder with one data set per system, named like it; None collects the paper's data set with the seed of
            the weights.
        workers: number of processes that collect.

    Raises:
        InputError: if the weights or the data are missing or do not fit.
    """
    for system in weights.systems:
        model = WorldModel.load(weights.source(system))
        held_out = _held_out(model, system, data, workers)
        scores = {}
        with progress(f"Evaluating {system}", total=len(CONTEXTS)) as advance:
            for context in CONTEXTS:
                scores[context] = evaluate(model, held_out.recordings, context)
                advance()
        yield from figures_of(system, scores, held_out, model.meta or {})


@dataclass(frozen=True)
class HeldOut:
    """Recordings that the weights have not seen.

    Attributes:
        recordings: the validation split.
        exact: whether the data set is, to the bit, the one that the weights were trained on. It is not where another
            OpenGL driver shades a pixel differently; the split is the same.
        collecting_s: how long making the data set takes.
        details: where the data come from.
    """

    recordings: Dataset
    exact: bool
    collecting_s: float
    details: dict[str, Any]


def figures_of(system: str, scores: dict[int, Evaluation], held_out: HeldOut, meta: dict[str, Any]) -> Iterator[Figure]:
    """The rows of one system."""
    about = {"same_data_as_training": held_out.exact, **held_out.details}
    for context, score in scores.items():
        yield Figure(
            measure=f"VPT from {context} frames",
            system=system,
            reached=score.vpt_fraction,
            required=VPT if context == CONTEXTS[0] else None,
            interval=score.vpt_interval,
            count=score.sequences,
            details={"valid_to_the_end": score.vpt_full, "frames": score.frames, "epsilon": score.epsilon, **about},
        )
    r2 = scores[CONTEXTS[0]].circular_r2
    yield Figure(
        measure="circular R², worst joint",
        system=system,
        reached=min(r2.values()) if r2 else None,
        required=CIRCULAR_R2,
        count=scores[CONTEXTS[0]].sequences,
        details={**(r2 or {"reason": "the data set records no joint positions"}), **about},
    )
    seconds = meta.get("seconds")
    yield Figure(
        measure="collect and train, s",
        system=system,
        reached=None if seconds is None else round(seconds + held_out.collecting_s, 1),
        required=SECONDS,
        at_most=True,
        details={
            "training_s": seconds,
            "collecting_s": round(held_out.collecting_s, 1),
            "preset": meta.get("preset"),
            "seed": meta.get("seed"),
            "note": "training as recorded where the weights were made, collecting as measured here",
        },
    )


def _held_out(model: WorldModel, system: str, data: Path | None, workers: int) -> HeldOut:
    meta = model.meta or {}
    made_from = meta.get("data", {})
    seed = made_from.get("seed", meta.get("seed", 0))
    settings = CollectSettings(resolve_env_id(model.system or system), seed=seed)
    with TemporaryDirectory(prefix="keycld-bench-") as made:
        count = made_from.get("recordings", RECORDINGS) if data is None else SAMPLE
        frames_per_second = collect(made, settings, count, workers).frames_per_second
        dataset = read_dataset(made if data is None else data / system)
    return HeldOut(
        recordings=dataset.split(meta.get("validation", 0.1))[1],
        exact=dataset.sha256 == made_from.get("sha256"),
        collecting_s=len(dataset) * settings.steps / frames_per_second,
        details={"data_seed": seed} if data is None else {"data": str(data / system)},
    )
