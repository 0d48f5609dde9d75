"""Seconds after which a search ends with the best it has."""

import math
import time
from dataclasses import dataclass, field

from keycld_envs.checks import short
from keycld_envs.errors import InputError

SEARCH = 0.6
"""Share of a budget after which nothing long is begun: what was found is then tested on held-out recordings."""


class OutOfTime(Exception):
    """The budget is spent."""


@dataclass
class Budget:
    """Seconds that may be spent, from now on; None for as many as it takes.

    Attributes:
        seconds: in all.
        not_tried: what was left out because they were spent.
    """

    seconds: float | None = None
    not_tried: list[str] = field(default_factory=list)
    _begun: float = field(default_factory=time.monotonic, repr=False)

    def __post_init__(self) -> None:
        """Raise InputError if it is no time."""
        seconds = self.seconds
        if seconds is None:
            return
        if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 < seconds < math.inf:
            raise InputError(f"budget must be a positive number of seconds, got {short(seconds)}.")

    @property
    def spent(self) -> bool:
        """Whether the seconds are over that may be spent before what was found is tested."""
        return self.seconds is not None and time.monotonic() - self._begun > SEARCH * self.seconds

    def check(self, number: int) -> None:
        """End a search once, after a number of sets of effects, if it is time to.

        Raises:
            OutOfTime: if so, for the first time; what follows is short.
        """
        if self.spent and not self.not_tried:
            self.not_tried.append(f"sets of effects after the first {number}")
            raise OutOfTime

    def leaves_out(self, what: str) -> bool:
        """Whether there is no time for something, which is then noted."""
        spent = self.spent
        if spent:
            self.not_tried.append(what)
        return spent
