"""Functions of arrays that effects are written with: NumPy's, or those of a compiler that traces them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
State = TypeVar("State")
_FUNCTIONS: ContextVar[Any] = ContextVar("functions", default=None)


@contextmanager
def using(module: Any) -> Iterator[None]:
    """Compute with the functions of another module than that of the arrays, while a compiler traces effects."""
    token = _FUNCTIONS.set(module)
    try:
        yield
    finally:
        _FUNCTIONS.reset(token)


def functions(x: Any) -> Any:
    """Module with the functions for an array, NumPy for its own; see `using`."""
    return _FUNCTIONS.get() or x.__array_namespace__()


def repeated(number: int, step: Callable[[State], State], state: State, x: Any) -> State:
    """A state after so many steps, with the loop of the module that computes with x; see `functions`."""
    loop = getattr(functions(x), "repeated", None)
    if loop is not None:
        return loop(number, step, state)
    for _ in range(number):
        state = step(state)
    return state


def if_any(condition: Any, then: Callable[[], State], otherwise: Callable[[], State], x: Any) -> State:
    """One value or another for whole arrays: a compiled program computes only the one that it needs."""
    choose = getattr(functions(x), "if_any", None)
    if choose is not None:
        return choose(condition, then, otherwise)
    return then() if np.any(condition) else otherwise()


def smooth_sign(speed: Array) -> Array:
    """Sign of a speed (rad/s or m/s), continuous through zero."""
    return functions(speed).tanh(speed / 0.02)
