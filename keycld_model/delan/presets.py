"""Recipes of joint models."""

from dataclasses import dataclass

from keycld_model.delan.config import Family


@dataclass(frozen=True)
class Preset:
    """A family, the size of its networks, and how long it is trained.

    Attributes:
        family: of `keycld_model.delan.families`.
        about: one line for people.
        width: units of each hidden layer.
        depth: hidden layers.
        iterations: Levenberg-Marquardt steps at most.
        patience: steps without a validation error that is lower by 1 %, after which training stops.
        samples: at most so many are learned from, spread evenly.
    """

    family: Family
    about: str
    width: int = 24
    depth: int = 2
    iterations: int = 40
    patience: int = 8
    samples: int = 20_000


PRESETS: dict[str, Preset] = {
    "structured": Preset(
        "structured", "Deep Lagrangian Network: polynomials and networks for the mass matrix's factor and the potential"
    ),
    "black_box": Preset("black_box", "one network for the Lagrangian"),
    "hamiltonian": Preset(
        "hamiltonian", "Hamiltonian network: the same for the inverse mass matrix's factor and the potential"
    ),
    "feed_forward": Preset("feed_forward", "two networks, for torques and for accelerations, without mechanics"),
}
"""All, by name; a recipe is declared here and nowhere else."""
