"""Which weights are measured."""

from dataclasses import dataclass
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.systems import REFERENCE_SYSTEMS


@dataclass(frozen=True)
class Weights:
    """Where the weights of every system are.

    Attributes:
        systems: short names of the systems to measure.
        folder: holds one checkpoint per system, named like it; None stands for the shipped weights.
    """

    systems: tuple[str, ...] = REFERENCE_SYSTEMS
    folder: Path | None = None

    def source(self, system: str) -> str:
        """What `WorldModel.load` takes."""
        return system if self.folder is None else str(self.folder / system)

    def check(self) -> None:
        """Load all weights once, so that a long measurement does not end for want of some.

        Raises:
            InputError: if some are missing, damaged, or of another version.
        """
        from keycld_model import WorldModel
        from keycld_model.stored import shipped_models

        there = (
            shipped_models() if self.folder is None else {p.parent.name for p in self.folder.glob("*/*.safetensors")}
        )
        if missing := [system for system in self.systems if system not in there]:
            where = "this installation" if self.folder is None else str(self.folder)
            remedy = "" if self.folder is not None else ", or name a folder of checkpoints with --weights"
            raise InputError(f"There are no weights for {', '.join(missing)} in {where}; train them{remedy}.")
        for system in self.systems:
            WorldModel.load(self.source(system))
