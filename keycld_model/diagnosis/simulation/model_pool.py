"""Copies of a compiled model, used again and again: copying its textures takes longer than a rollout."""

import copy

import mujoco
import numpy as np

LARGEST = 100_000
"""Arrays with more bytes are assets, which no variant changes."""


class ModelPool:
    """Copies of one model.

    Attributes:
        model: what they are copies of.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._numbers = _arrays(model)
        self._copies: list[tuple[mujoco.MjModel, list[np.ndarray]]] = []

    def take(self, number: int) -> list[mujoco.MjModel]:
        """So many copies, as the model is now; those handed out before are among them."""
        while len(self._copies) < number:
            twin = copy.copy(self.model)
            self._copies.append((twin, _arrays(twin)))
        out = self._copies[:number]
        for twin, arrays in out:
            for mine, original in zip(arrays, self._numbers, strict=True):
                mine[...] = original
            twin.opt.disableflags = self.model.opt.disableflags
        return [twin for twin, _ in out]


def _arrays(model: mujoco.MjModel) -> list[np.ndarray]:
    """Views of all numbers of a model that a variant may change."""
    owners = (model, model.opt)
    fields = (getattr(owner, name) for owner in owners for name in dir(owner) if not name.startswith("_"))
    return [field for field in fields if isinstance(field, np.ndarray) and field.size and field.nbytes < LARGEST]
