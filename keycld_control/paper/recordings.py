"""The recordings that models are trained and tested with: the paper's, and what it did not have."""

from dataclasses import dataclass
from pathlib import Path

from keycld_control.paper.measures.long import horizon
from keycld_envs import resolve_env_id
from keycld_envs.collect import PAPER_ACTION_RANGE, CollectSettings, collect
from keycld_envs.recordings import Dataset, read_dataset

TRAINING = 500
"""Recordings of the paper's data set, a tenth of which validates."""


@dataclass(frozen=True)
class Part:
    """A data set.

    Attributes:
        title: for people.
        episodes: recordings.
        policy: of the actions.
        velocity: bound on initial joint velocities, rad/s or m/s.
        action_range: bound on actions; None is the paper's.
        steps: frames; None for as many as the long measures need.
        seed: added to the data's own.
    """

    title: str
    episodes: int
    policy: str = "constant"
    velocity: float = 0.0
    action_range: float | None = None
    steps: int | None = 50
    seed: int = 0


PARTS: dict[str, Part] = {
    "training": Part("the paper's", TRAINING),
    "test": Part("fresh recordings of the same kind", 50, seed=1000),
    "long": Part("long, constant actions", 20, steps=None, seed=2000),
    "varying": Part("actions that vary", 50, "piecewise", seed=3000),
    "moving": Part("actions that vary, starts in motion", 50, "piecewise", velocity=3.0, seed=4000),
    "strong": Part("constant actions, up to twice as strong", 50, action_range=2 * PAPER_ACTION_RANGE, seed=5000),
}
"""Seeds of the tests are never those of training."""
VARIED = ("varying", "moving", "strong")
"""Tests of 50 frames with actions or starts like none of training."""


def recordings(folder: Path, system: str, part: str, seed: int, workers: int = 1) -> Dataset:
    """A data set of a system, made if it is not there yet."""
    what = PARTS[part]
    settings = CollectSettings(
        resolve_env_id(system),
        steps=horizon(system) if what.steps is None else what.steps,
        policy=what.policy,
        velocity=what.velocity,
        action_range=what.action_range,
        seed=seed + what.seed,
    )
    out = folder / system / part
    collect(out, settings, what.episodes, workers)
    return read_dataset(out)
