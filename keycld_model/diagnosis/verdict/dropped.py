"""Steps of a diagnosis that numbers ran away in: they are left out, and the report says so."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

T = TypeVar("T")


class Dropped(list[str]):
    """Steps that were left out, and why, a line each; what was found before them stands."""

    def tried(self, name: str, step: Callable[[], T]) -> T | None:
        """The result of a step; None, with one more line, if numbers run away in it.

        Raises:
            InputError: if the step does; what a user can repair is not left out, nor is a bug.
        """
        try:
            return step()
        except (np.linalg.LinAlgError, ArithmeticError) as error:
            self.append(f"{name}: {error}")
            return None
