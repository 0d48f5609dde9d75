"""Models that effects have edited."""

import copy
from collections.abc import Sequence

import mujoco

from keycld_envs.constants import update_constants
from keycld_envs.effects.base import Effect


def edited(model: mujoco.MjModel, effects: Sequence[Effect]) -> mujoco.MjModel:
    """A copy of a compiled model with the numbers that effects change."""
    out = copy.copy(model)
    for effect in effects:
        effect.edit(out)
    update_constants(out)
    return out
