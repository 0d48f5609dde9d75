"""The reference systems. One file per system; a system is data."""

import difflib

from keycld_envs.errors import InputError
from keycld_envs.systems.acrobot import ACROBOT, ACROBOT_STOCK
from keycld_envs.systems.base import Joint, Landmark, Start, System, Tolerance
from keycld_envs.systems.cartpole import CARTPOLE, CARTPOLE_STOCK
from keycld_envs.systems.pendulum import PENDULUM, PENDULUM_STOCK

SYSTEMS: dict[str, System] = {
    system.name: system for system in (PENDULUM, CARTPOLE, ACROBOT, PENDULUM_STOCK, CARTPOLE_STOCK, ACROBOT_STOCK)
}


def get_system(name: str) -> System:
    """The system called `name`, for instance "acrobot" or "acrobot-stock".

    Raises:
        InputError: if there is none; the message suggests similar names.
    """
    if name not in SYSTEMS:
        similar = difflib.get_close_matches(name.lower(), SYSTEMS, n=2) or sorted(SYSTEMS)
        raise InputError(f"There is no system {name!r}; did you mean {' or '.join(map(repr, similar))}?")
    return SYSTEMS[name]


__all__ = ["SYSTEMS", "Joint", "Landmark", "Start", "System", "Tolerance", "get_system"]
