"""What is trained and measured."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from keycld_envs.systems import REFERENCE_SYSTEMS

ABLATIONS = {"default": "KeyCLD", "nc": "KeyCLD-NC", "node2": "NODE2", "fc": "FC"}
"""Presets of the paper's table 1, and their titles."""
OPTIMISERS = {"joint": "the paper's loss, 6,000 steps", "joint-sign": "the same, sign descent"}
"""The paper's loss and optimiser, and with the optimiser that its code had."""
TITLES = ABLATIONS | OPTIMISERS
"""All presets of the report."""
AMOUNTS = (25, 50, 100, 200)
"""Sequences to train with; 450 are the paper's."""
WHOLE = 450
PAPER_VPT: dict[str, dict[str, float]] = {
    "default": {"pendulum": 0.38, "cartpole": 1.00, "acrobot": 1.00},
    "nc": {"pendulum": 0.20, "cartpole": 0.48, "acrobot": 0.50},
    "node2": {"pendulum": 0.12, "cartpole": 0.26, "acrobot": 0.44},
    "fc": {"pendulum": 0.00, "cartpole": 0.10, "acrobot": 0.00},
}
"""The paper's table 1, by preset and system; fractions of 50 frames, from two frames."""


@dataclass(frozen=True, order=True)
class Training:
    """One model to be trained.

    Attributes:
        system: short name.
        preset: of `keycld_model.training.PRESETS`.
        seed: of initialisation and batches.
        sequences: recordings to train with.
    """

    system: str
    preset: str = "default"
    seed: int = 0
    sequences: int = WHOLE

    @property
    def name(self) -> str:
        """Of its folder."""
        amount = "" if self.sequences == WHOLE else f"-{self.sequences}"
        return f"{self.system}-{self.preset}-{self.seed}{amount}"

    @property
    def is_default(self) -> bool:
        """Whether it is our recipe on the paper's data, of which most is measured."""
        return self.preset == "default" and self.sequences == WHOLE

    @property
    def recordings(self) -> int:
        """Recordings to be divided, a tenth of which validates."""
        return max(n for n in range(self.sequences, 2 * self.sequences) if n - n // 10 == self.sequences)


def trainings(systems: Sequence[str] = REFERENCE_SYSTEMS, seeds: int = 3) -> Iterator[Training]:
    """All models, the most wanted first: one seed of each before the others."""
    for seed in range(seeds):
        for preset in ABLATIONS:
            yield from (Training(system, preset, seed) for system in systems)
        if seed == 0:
            for preset in OPTIMISERS:
                yield from (Training(system, preset, seed) for system in systems)
            for amount in AMOUNTS:
                yield from (Training(system, "default", seed, amount) for system in systems)
