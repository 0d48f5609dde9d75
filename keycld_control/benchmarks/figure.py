"""One measured figure, beside what it must reach."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One row of the report.

    Attributes:
        measure: what was measured, in words.
        system: of which system.
        reached: the figure; None if it could not be measured, with the reason in `details`.
        required: what it must reach; None if it stands there for comparison.
        at_most: whether smaller is better.
        interval: 95 % interval of the figure.
        count: how many episodes, sequences or runs it comes from.
        details: whatever else is worth knowing.
    """

    measure: str
    system: str
    reached: float | None
    required: float | None = None
    at_most: bool = False
    interval: tuple[float, float] | None = None
    count: int | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def met(self) -> bool | None:
        """Whether the figure is good enough; None where nothing is required or nothing was measured."""
        if self.reached is None or self.required is None:
            return None
        reached = round(self.reached, 9)  # a mean of fractions may fall one bit short of .98
        return reached <= self.required if self.at_most else reached >= self.required
