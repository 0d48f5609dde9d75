"""A parameter that is refitted before anything is called missing."""

from dataclasses import dataclass

FACTOR_UNIT = "of the simulator's"
"""Unit of what is reported of a factor."""


@dataclass(frozen=True)
class Nuisance:
    """A parameter of a simulator or a sensor that is never quite what it is believed to be.

    Attributes:
        name: for instance "mass of upper_arm".
        kind: which parameter it is, such as "mass" or "zero".
        index: the body, joint or channel that it belongs to.
        spread: standard deviation expected of it.
        unit: of what is reported.
        factor: it is the logarithm of a factor of the simulator's own value.
    """

    name: str
    kind: str
    index: int
    spread: float
    unit: str = FACTOR_UNIT
    factor: bool = False

    @property
    def step(self) -> float:
        """Step of finite differences with respect to it.

        That of factors is short: what longer ones leave out would tell the scale of all masses, which a motion without
        torques does not.
        """
        return 1e-4 if self.factor else 0.02 * self.spread
