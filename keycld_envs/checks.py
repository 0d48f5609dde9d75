"""Checks of what users hand in; every failure is an `InputError` of one sentence."""

import difflib
import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, Literal, TypeVar, cast

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.errors import InputError

LARGEST_SIDE = 8192
"""Pixels of an image's side."""
MOST_WORKERS = 1024
"""Processes."""
LONGEST_VALUE = 80
"""Characters of a value in a message."""
T = TypeVar("T")
ObsType = Literal["pixels", "state", "pixels_state"]


def check_choice(name: str, value: object, choices: Sequence[object]) -> None:
    """Refuse a `value` that is none of `choices`.

    Raises:
        InputError: if it is none.
    """
    if not isinstance(value, str | None) or value not in choices:
        raise InputError(f"{name} must be one of {', '.join(map(repr, choices))}, got {short(value)}.")


def check_size(name: str, value: int) -> int:
    """Return an image's `width` or `height` in pixels if it is a whole number of at least 2.

    Raises:
        InputError: if it is not.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 2:
        raise InputError(f"{name} must be a whole number of at least 2 pixels, got {short(value)}.")
    if value > LARGEST_SIDE:
        raise InputError(f"{name} must be {LARGEST_SIDE} pixels at most, got {short(value)}.")
    return int(value)


def check_action_limit(value: float) -> float:
    """Return the symmetric control limit if it is positive and finite.

    Raises:
        InputError: if it is not.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 < value <= 1e300:
        raise InputError(f"action_limit must be a positive finite number, got {short(value)}.")
    return float(value)


def check_whole(name: str, value: object, least: int, most: int) -> None:
    """Refuse what is no whole number between two others.

    Raises:
        InputError: if it is none.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= cast(int, value) <= most:
        raise InputError(f"{name} is {short(value)}; it must be a whole number from {least} to {most}.")


def check_number(name: str, value: object, above: float, most: float, *, inclusive: bool = False) -> None:
    """Refuse what is no number above one, or just that if `inclusive`, and up to another.

    Raises:
        InputError: if it is none.
    """
    number = cast(float, value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    if not (number > above or (inclusive and number == above)) or not number <= most:
        least = f"from {above:g}" if inclusive else f"above {above:g},"
        raise InputError(f"{name} is {short(value)}; it must be a number {least} up to {most:g}.")


def check_camera(model: mujoco.MjModel, name: str) -> str:
    """Return `name` if the model has a camera of that name.

    Raises:
        InputError: if it has none.
    """
    cameras = _some_cameras(model)
    if not isinstance(name, str) or name not in cameras:
        similar = difflib.get_close_matches(str(name), cameras, n=1)
        hint = f"did you mean {similar[0]!r}?" if similar else f"it has {', '.join(map(repr, cameras))}."
        raise InputError(f"The model has no camera {short(name)}; {hint}")
    return name


def the_camera(model: mujoco.MjModel, name: str | None = None) -> str:
    """A camera of a model: the one of that name, or the only one.

    Raises:
        InputError: if there is none of that name, or there is not one alone.
    """
    if name is not None:
        return check_camera(model, name)
    cameras = _some_cameras(model)
    if len(cameras) > 1:
        raise InputError(f"The model has the cameras {', '.join(cameras)}; say which one looks, --camera NAME.")
    return cameras[0]


def _some_cameras(model: mujoco.MjModel) -> list[str]:
    """Names of a model's cameras, one at least."""
    if not model.ncam:
        raise InputError('The model has no camera; add one to its <worldbody>: <camera name="front" pos=... />.')
    return [model.camera(i).name for i in range(model.ncam)]


def several(name: str, value: Any, kind: type[T]) -> tuple[T, ...]:
    """A tuple or list of what is all of one class, as a tuple.

    Raises:
        InputError: if it is something else, for instance a single one without its comma.
    """
    if isinstance(value, kind) and kind is not str:
        raise InputError(
            f"{name} is one {kind.__name__}, not a tuple of them; write a comma behind it, {name}=(..., )."
        )
    if not isinstance(value, tuple | list):
        raise InputError(f"{name} must be a tuple of {kind.__name__}, got {short(value)}.")
    if wrong := [each for each in value if not isinstance(each, kind)]:
        raise InputError(f"{name} must be a tuple of {kind.__name__}, but has {short(wrong[0])}.")
    return tuple(value)


def short(value: object) -> str:
    """How a value is written in a message: the first characters of its `repr`, in one line."""
    try:
        text = " ".join(repr(value).split())
    except Exception as error:  # of a class of somebody else's, or an integer of too many digits
        text = f"a {type(value).__name__} ({error})"
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def finite_vector(name: str, value: ArrayLike, size: int) -> NDArray[np.float64]:
    """Return `value` as a vector [size] of finite numbers.

    Raises:
        InputError: if it has another shape, or is not finite or not numeric.
    """
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be {size} numbers, got {short(value)}.") from error
    if vector.shape != (size,):
        raise InputError(f"{name} must have shape ({size},), got {vector.shape}.")
    if not np.isfinite(vector).all():
        raise InputError(f"{name} must be finite, got {short(vector.tolist())}.")
    return vector
