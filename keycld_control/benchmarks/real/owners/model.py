"""A mechanism as its owners identified it."""

from dataclasses import dataclass

import mujoco

from keycld_envs.effects import Effect


@dataclass(frozen=True)
class OwnersModel:
    """A simulator with friction.

    Attributes:
        name: of the owners' file.
        simulator: without friction.
        effects: the friction, and what else they found.
    """

    name: str
    simulator: mujoco.MjModel
    effects: tuple[Effect, ...]
