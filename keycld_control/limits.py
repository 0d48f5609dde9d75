"""Between which bounds actions have to stay."""

from contextlib import closing

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from keycld_envs import make, resolve_env_id
from keycld_envs.errors import InputError


def action_bounds(
    system: str | None, size: int, action_space: spaces.Space | None = None, action_limit: ArrayLike | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lower and upper bounds `[m]` of the action.

    Args:
        system: short name or environment id whose default bounds hold if nothing else is given.
        size: m, the number of actions.
        action_space: the environment's action space.
        action_limit: symmetric limit, one number or `[m]`; not together with `action_space`.

    Raises:
        InputError: if the bounds are unknown, given twice, of another size, or do not enclose zero (infinity does).
    """
    if action_space is not None and action_limit is not None:
        raise InputError("action_space and action_limit exclude each other; give one of them.")
    if action_limit is not None:
        limit = np.asarray(action_limit, np.float32)
        low, high = -limit, limit
    elif isinstance(action_space, spaces.Box):
        low, high = action_space.low, action_space.high
    elif action_space is not None:
        raise InputError(f"action_space must be a gymnasium.spaces.Box, got {action_space}.")
    else:
        low, high = default_bounds(system)
    if low.shape not in ((), (size,)):
        raise InputError(f"The action bounds have shape {low.shape}, but the model has {size} action(s).")
    low, high = (np.broadcast_to(bound, (size,)).astype(np.float32) for bound in (low, high))
    if not ((low < 0).all() and (high > 0).all()):  # also false for NaN
        raise InputError(f"Action bounds must enclose zero, got {low.tolist()} to {high.tolist()}.")
    return low, high


def default_bounds(system: str | None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bounds of the registered environment of a system.

    Raises:
        InputError: if there is no such environment.
    """
    if system is None:
        raise InputError("The model names no system; give action_space=env.action_space.")
    try:
        env_id = resolve_env_id(system)
    except InputError as error:
        raise InputError(
            f"The model's system {system!r} is no registered environment; give action_space=env.action_space."
        ) from error
    with closing(make(env_id, disable_env_checker=True)) as env:
        assert isinstance(env.action_space, spaces.Box)
        return env.action_space.low, env.action_space.high
