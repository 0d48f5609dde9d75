"""Frames per second of the environments, against dm_control's own pixels in the same process."""

import importlib
import importlib.util
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from keycld_control.benchmarks.figure import Figure
from keycld_envs import REFERENCE_SYSTEMS, InputError, KeyCLDEnv
from keycld_envs.progress import progress

SIZE = 64
REPEATS, STEPS = 9, 40
REQUIRED = {"fast": 5.0, "full": 1.0}


def speed_figures(
    systems: Sequence[str] = REFERENCE_SYSTEMS, repeats: int = REPEATS, steps: int = STEPS
) -> Iterator[Figure]:
    """Frames per second with a 64 x 64 image each step: dm_control's, and KeyCLD's in both render qualities.

    The three take turns, so that other load on the machine meets all alike. A figure is the ratio to dm_control within
    a turn; its details are fps_dm_control, fps_fast, fps_full, ratio_fast and ratio_full, or the reason why there are
    none where dm_control is not installed or has no such system.

    Args:
        systems: short names.
        repeats: number of turns; medians over turns are returned.
        steps: steps per turn.

    Raises:
        InputError: if there is no OpenGL, of which dm_control would say less.
    """
    with closing(KeyCLDEnv(REFERENCE_SYSTEMS[0])) as env:
        env.reset(seed=0)
    for system in systems:
        try:
            with progress(f"Frames/s of {system}", total=repeats) as advance:
                measured = _measure(system, repeats, steps, advance)
        except InputError as error:
            measured = {"reason": str(error)}
        for quality, required in REQUIRED.items():
            ratio = measured.get(f"ratio_{quality}")
            yield Figure(
                measure=f"frames/s ÷ dm_control's, {quality}",
                system=system,
                reached=ratio if isinstance(ratio, float) else None,
                required=required,
                count=repeats,
                details=measured,
            )


def _measure(system: str, repeats: int, steps: int, advance: Callable[[], object] = lambda: None) -> dict[str, float]:
    with (
        closing(_dm_control(system)) as theirs,
        closing(KeyCLDEnv(system, render_quality="fast")) as fast,
        closing(KeyCLDEnv(system, render_quality="full")) as full,
    ):
        action = np.zeros(theirs.action_spec().shape)
        turns = (lambda: theirs.step(action), _stepper(fast), _stepper(full))
        theirs.reset()
        for warm_up in turns:
            warm_up()
        seconds = np.empty((repeats, len(turns)))
        for turn in seconds:
            turn[:] = [_time(step, steps) for step in turns]
            advance()
    dm_control, fast_fps, full_fps = np.median(steps / seconds, axis=0)
    ratio_fast, ratio_full = np.median(seconds[:, :1] / seconds[:, 1:], axis=0)
    return {
        "fps_dm_control": round(float(dm_control), 1),
        "fps_fast": round(float(fast_fps), 1),
        "fps_full": round(float(full_fps), 1),
        "ratio_fast": round(float(ratio_fast), 2),
        "ratio_full": round(float(ratio_full), 2),
    }


def _dm_control(system: str) -> Any:
    # imported here: dm_control opens its OpenGL display when imported
    try:
        from dm_control.suite.wrappers import pixels
    except ModuleNotFoundError as error:
        raise InputError(
            f"There is no dm_control to compare with ({error}); run this benchmark with Python 3.11 or 3.12, where "
            "keycld installs dm-control."
        ) from error

    if importlib.util.find_spec(f"dm_control.suite.{system}") is None:
        raise InputError(f"dm_control has no {system} to compare with.")
    env = importlib.import_module(f"dm_control.suite.{system}").swingup(time_limit=float("inf"))
    return pixels.Wrapper(env, render_kwargs={"height": SIZE, "width": SIZE, "camera_id": 0})


def _stepper(env: KeyCLDEnv) -> Callable[[], Any]:
    env.reset(seed=0)
    action = np.zeros(env.model.nu)
    return lambda: env.step(action)


def _time(step: Callable[[], Any], steps: int) -> float:
    start = time.perf_counter()
    for _ in range(steps):
        step()
    return time.perf_counter() - start
