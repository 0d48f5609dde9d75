"""Named recipes: networks and stages."""

from dataclasses import dataclass, replace
from typing import Any

from keycld_envs.checks import check_number
from keycld_model.config import PAPER_NETWORKS, NetworkConfig
from keycld_model.training.align import Align
from keycld_model.training.discover import Discover
from keycld_model.training.distil import Distil
from keycld_model.training.fit import FitTrajectories, FitWindows
from keycld_model.training.joint import Joint
from keycld_model.training.relocate import Rediscover, Relocate
from keycld_model.training.stage import Stage

DESCENT = 500
"""Steps of the optimiser that stand for second-order ones."""


@dataclass(frozen=True)
class Preset:
    """A recipe.

    Attributes:
        networks: sizes of the networks.
        stages: what is trained, in order.
        length: longest sequence, frames; longer recordings are cut.
        about: what it is, in a few words, for `keycld presets`.
    """

    networks: NetworkConfig
    stages: tuple[Stage, ...]
    length: int = 50
    about: str = ""

    @property
    def steps(self) -> int:
        """Optimiser steps in all."""
        return sum(stage.steps for stage in self.stages)


RELOCATION = 2 * (
    Relocate(steps=200, batch=16, learning_rate=4e-3),
    Rediscover(steps=400, batch=8, learning_rate=2e-3),
)
"""Twice, since two parts may be left without a keypoint; what is not needed is left out."""

DEFAULT = Preset(
    NetworkConfig(),
    (
        Discover(steps=700, batch=8, learning_rate=4e-3),
        *RELOCATION,
        FitWindows(steps=500, batch=64, learning_rate=1e-2, window=6, linear=True),
        FitTrajectories(portion=0.25, restart=True, identify=10),
        FitTrajectories(portion=0.5, identify=10, sparse=True),
        FitTrajectories(steps=200, identify=10, sparse=True),
        Distil(steps=1000, batch=8, learning_rate=4e-3),
        FitTrajectories(identify=10, sparse=True, acting=True),
        Distil(steps=3500, batch=8, learning_rate=4e-3),
        FitTrajectories(steps=200, learning_rate=5e-4, slide=False, identify=10, sparse=True, acting=True),
    ),
    about="in stages; minutes on two CPU cores",
)

QUICK = Preset(
    NetworkConfig(rigid_parts=True),
    (
        Discover(steps=500, batch=8, learning_rate=4e-3),
        *RELOCATION,
        FitWindows(steps=300, batch=64, learning_rate=1e-2, window=6, linear=True),
        FitTrajectories(portion=0.25, restart=True, identify=10),
        FitTrajectories(identify=10, sparse=True),
        Align(steps=800, batch=16, learning_rate=5e-3, share=0.2),
        Align(steps=400, batch=16, learning_rate=2e-3),
        FitTrajectories(slide=False, identify=10, sparse=True, acting=True),
        Distil(steps=2000, batch=8, learning_rate=4e-3, composed=4),
    ),
    about="fewer fits; draws rigid parts, and aligns keypoints with frames",
)

FINE_TUNING = Preset(
    NetworkConfig(),
    (
        FitTrajectories(portion=0.5, restart=True, slide=False, identify=10, sparse=True),
        FitTrajectories(steps=500, learning_rate=1e-3, slide=False, identify=10, sparse=True),
    ),
    about="goes on with the dynamics of a trained model",
)
"""For `train(..., start=...)`; not among `PRESETS`, which start from nothing."""

JOINT = Joint(steps=45_000, batch=1, learning_rate=3e-4)
"""The paper's table 2."""


def with_networks(preset: Preset, **changes: Any) -> Preset:
    """The same recipe for other networks; where few numbers no longer describe the motion, gradient descent fits it."""
    changed = replace(preset, networks=replace(preset.networks, **changes))
    return changed if changed.networks.identifiable else by_gradient_descent(changed)


def with_rate(preset: Preset, scale: float) -> Preset:
    """The same recipe with all learning rates multiplied by `scale`."""
    check_number("learning_rate_scale", scale, 0.0, 1e6)
    return replace(preset, stages=tuple(replace(s, learning_rate=scale * s.learning_rate) for s in preset.stages))


def by_gradient_descent(preset: Preset) -> Preset:
    """The same recipe without second-order steps: at least `DESCENT` steps of the optimiser in their place."""

    def change(stage: Stage) -> Stage:
        if isinstance(stage, FitTrajectories):
            return replace(stage, identify=0, steps=max(stage.steps, DESCENT))
        return stage

    return replace(preset, stages=tuple(map(change, preset.stages)))


PRESETS: dict[str, Preset] = {
    "default": DEFAULT,
    "quick": QUICK,
    "nc": replace(
        with_networks(DEFAULT, motion="unconstrained"), about="the paper's ablation KeyCLD-NC: default, no constraints"
    ),
    "node2": replace(
        with_networks(DEFAULT, motion="acceleration"),
        about="the paper's ablation NODE2: default, a network for the acceleration",
    ),
    "fc": replace(
        with_networks(DEFAULT, images="fully_connected"),
        about="the paper's ablation FC: default, fully connected estimator and renderer",
    ),
    "joint": replace(
        DEFAULT,
        stages=(replace(JOINT, steps=6000),),
        about="the paper's loss and optimiser on the networks of default",
    ),
    "joint-sign": replace(
        DEFAULT,
        stages=(replace(JOINT, steps=6000, forgetful=True),),
        about="joint with the optimiser that the reference's code had: Adam that forgets",
    ),
    "paper": Preset(PAPER_NETWORKS, (JOINT,), about="exact hyperparameters of the paper's table 2; days"),
}
"""All, by name; a recipe is declared here and nowhere else."""
