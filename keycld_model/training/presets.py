"""Named recipes: networks and stages."""

from dataclasses import dataclass

from keycld_model.config import PAPER_NETWORKS, NetworkConfig
from keycld_model.training.discover import Discover
from keycld_model.training.distil import Distil
from keycld_model.training.fit import FitTrajectories, FitWindows
from keycld_model.training.joint import Joint
from keycld_model.training.stage import Stage


@dataclass(frozen=True)
class Preset:
    """A recipe.

    Attributes:
        networks: sizes of the networks.
        stages: what is trained, in order.
        length: longest sequence, frames; longer recordings are cut.
    """

    networks: NetworkConfig
    stages: tuple[Stage, ...]
    length: int = 50

    @property
    def steps(self) -> int:
        """Optimiser steps in all."""
        return sum(stage.steps for stage in self.stages)


PRESETS: dict[str, Preset] = {
    "default": Preset(
        NetworkConfig(),
        (
            Discover(steps=700, batch=8, learning_rate=4e-3),
            FitWindows(steps=500, batch=64, learning_rate=1e-2, window=6, linear=True),
            FitTrajectories(portion=0.25, restart=True, identify=10),
            FitTrajectories(portion=0.5, identify=10, sparse=True),
            FitTrajectories(steps=200, identify=10, sparse=True),
            Distil(steps=1000, batch=8, learning_rate=4e-3),
            FitTrajectories(identify=10, sparse=True),
            Distil(steps=3500, batch=8, learning_rate=4e-3),
            FitTrajectories(steps=200, learning_rate=5e-4, slide=False, identify=10, sparse=True),
        ),
    ),
    "paper": Preset(PAPER_NETWORKS, (Joint(steps=45_000, batch=1, learning_rate=3e-4),)),
}
"""`default` trains in minutes on two CPU cores; `paper` has the exact hyperparameters of the paper's table 2."""
