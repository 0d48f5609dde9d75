"""Checks of what users hand in; every failure is an `InputError` of one sentence."""

import difflib
import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.errors import InputError

ObsType = Literal["pixels", "state", "pixels_state"]


def check_choice(name: str, value: object, choices: Sequence[object]) -> None:
    """Refuse a `value` that is none of `choices`.

    Raises:
        InputError: if it is none.
    """
    if value not in choices:
        raise InputError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}.")


def check_size(name: str, value: int) -> int:
    """Return an image's `width` or `height` in pixels if it is a whole number of at least 2.

    Raises:
        InputError: if it is not.
    """
    if not isinstance(value, Integral) or value < 2:
        raise InputError(f"{name} must be a whole number of at least 2 pixels, got {value!r}.")
    return int(value)


def check_action_limit(value: float) -> float:
    """Return the symmetric control limit if it is positive and finite.

    Raises:
        InputError: if it is not.
    """
    if not isinstance(value, Real) or not 0 < value < math.inf:
        raise InputError(f"action_limit must be a positive finite number, got {value!r}.")
    return float(value)


def check_camera(model: mujoco.MjModel, name: str) -> str:
    """Return `name` if the model has a camera of that name.

    Raises:
        InputError: if it has none.
    """
    cameras = [model.camera(i).name for i in range(model.ncam)]
    if name not in cameras:
        similar = difflib.get_close_matches(str(name), cameras, n=1)
        hint = f"did you mean {similar[0]!r}?" if similar else f"it has {', '.join(map(repr, cameras)) or 'none'}."
        raise InputError(f"The model has no camera {name!r}; {hint}")
    return name


def finite_vector(name: str, value: ArrayLike, size: int) -> NDArray[np.float64]:
    """Return `value` as a vector [size] of finite numbers.

    Raises:
        InputError: if it has another shape, or is not finite or not numeric.
    """
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be {size} numbers, got {value!r}.") from error
    if vector.shape != (size,):
        raise InputError(f"{name} must have shape ({size},), got {vector.shape}.")
    if not np.isfinite(vector).all():
        raise InputError(f"{name} must be finite, got {vector.tolist()}.")
    return vector
