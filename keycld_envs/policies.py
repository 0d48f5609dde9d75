"""Named open-loop excitations for data collection."""

import difflib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from keycld_envs.checks import short
from keycld_envs.errors import InputError

ZERO_FRACTION = 0.2
"""Fraction of runs (constant) or segments (piecewise) without any action."""

Policy = Callable[[np.random.Generator, int, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""(rng, steps, low [m], high [m]) -> actions [steps, m]."""


def constant(
    rng: np.random.Generator, steps: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The paper's excitation: one action for the whole run, uniform between the bounds, zero for 20 % of runs."""
    zero = rng.random() < ZERO_FRACTION
    action = rng.uniform(low, high)
    return np.tile(np.zeros_like(action) if zero else action, (steps, 1))


def piecewise(
    rng: np.random.Generator, steps: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A richer excitation: a new uniform action every 2 to 15 steps, zero for 20 % of the segments."""
    segments = []
    while sum(map(len, segments)) < steps:
        zero = rng.random() < ZERO_FRACTION
        action = rng.uniform(low, high)
        segments.append(np.tile(np.zeros_like(action) if zero else action, (int(rng.integers(2, 16)), 1)))
    return np.concatenate(segments)[:steps]


def release(
    rng: np.random.Generator, steps: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """No action: the mechanism is let go where it is."""
    return np.zeros((steps, len(low)))


POLICIES: dict[str, Policy] = {"constant": constant, "piecewise": piecewise, "release": release}


def get_policy(name: str) -> Policy:
    """The policy called `name`.

    Raises:
        InputError: if there is none; the message suggests a name.
    """
    if not isinstance(name, str):
        raise InputError(f"policy must be a name, got {short(name)}.")
    if name not in POLICIES:
        similar = difflib.get_close_matches(name.lower(), POLICIES, n=1) or sorted(POLICIES)
        raise InputError(f"There is no policy {name!r}; did you mean {' or '.join(map(repr, similar))}?")
    return POLICIES[name]
