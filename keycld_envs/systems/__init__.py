"""The systems that come with the library. One file per system; a system is data.

A new one is a file in this folder, named in `REFERENCE` below: environment ids, benchmarks, the paper's report,
examples and contract tests go through the list. Its trained weights are a folder of `keycld_model/weights`, named like
it.
"""

import difflib
from collections.abc import Collection

from keycld_envs.errors import InputError
from keycld_envs.systems.acrobot import ACROBOT, ACROBOT_STOCK
from keycld_envs.systems.base import Joint, Landmark, Start, System, Tolerance
from keycld_envs.systems.cartpole import CARTPOLE, CARTPOLE_STOCK
from keycld_envs.systems.pendulum import PENDULUM, PENDULUM_STOCK

REFERENCE = (PENDULUM, CARTPOLE, ACROBOT)
STOCK = (PENDULUM_STOCK, CARTPOLE_STOCK, ACROBOT_STOCK)

SYSTEMS: dict[str, System] = {system.name: system for system in (*REFERENCE, *STOCK)}
"""All, by short name."""
REFERENCE_SYSTEMS: tuple[str, ...] = tuple(system.name for system in REFERENCE)
"""Short names of those that weights are trained for and shipped, without dm_control's own variants of them."""


def chosen_systems(names: Collection[str]) -> tuple[str, ...]:
    """The reference systems among `names`, in order; all if `names` is empty.

    Raises:
        InputError: if a name is none of theirs.
    """
    if unknown := [name for name in names if name not in REFERENCE_SYSTEMS]:
        raise InputError(f"There is no reference system {unknown[0]!r}; there are {', '.join(REFERENCE_SYSTEMS)}.")
    return tuple(name for name in REFERENCE_SYSTEMS if name in (names or REFERENCE_SYSTEMS))


def get_system(name: str) -> System:
    """The system called `name`, for instance "acrobot" or "acrobot-stock".

    Raises:
        InputError: if there is none; the message suggests similar names.
    """
    if name not in SYSTEMS:
        similar = difflib.get_close_matches(name.lower(), SYSTEMS, n=2) or sorted(SYSTEMS)
        raise InputError(f"There is no system {name!r}; did you mean {' or '.join(map(repr, similar))}?")
    return SYSTEMS[name]


__all__ = [
    "REFERENCE_SYSTEMS",
    "SYSTEMS",
    "Joint",
    "Landmark",
    "Start",
    "System",
    "Tolerance",
    "chosen_systems",
    "get_system",
]
