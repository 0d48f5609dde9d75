"""Whole turns of hinges, which no single image shows."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TURN = 2 * np.pi
LOWEST = 0.5 - np.pi
"""Least angle around which a hinge moves, rad. What hangs at half a turn is seen at that on either side, and simulators
write it as the positive one."""


def on_common_turns(positions: Sequence[Array], turns: NDArray[np.bool_]) -> list[Array]:
    """Positions of one mechanism in several recordings, which all begin within half a turn of where it is mostly.

    A spring and a stop do not come again with every turn, so that recordings must count turns alike.

    Args:
        positions: of each recording, `[T, nq]`, rad or m, NaN where none were read; turns go on within each.
        turns: `[nq]` whether a joint looks the same after a full turn.
    """
    known = np.concatenate([q[np.isfinite(q).all(axis=1)] for q in positions])
    if not len(known):
        return list(positions)
    mostly = np.angle(np.mean(np.exp(1j * known), axis=0))
    mostly = np.where(mostly <= LOWEST, mostly + TURN, mostly)
    return [on_turns_of(mostly[None], q, turns) for q in positions]


def on_turns_of(there: Array, q: Array, turns: NDArray[np.bool_]) -> Array:
    """Positions `[T, nq]` of one recording, moved by whole turns until they begin nearest to others `[T or 1, nq]`."""
    both = np.flatnonzero(np.isfinite(q).all(axis=1) & np.isfinite(there).all(axis=1))
    if not len(both):
        return q
    first = both[0]
    return q + (nearest_turn(q[first], np.broadcast_to(there, q.shape)[first], turns) - q[first])


def nearest_turn(q: Array, there: Array, turns: NDArray[np.bool_]) -> Array:
    """Positions `[..., nq]`, moved by whole turns to where they are nearest to others `[..., nq]`."""
    return np.where(turns, q - TURN * np.round((q - there) / TURN), q)
