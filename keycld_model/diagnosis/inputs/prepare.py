"""Recordings made ready: some held out, and none sampled faster than is useful."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.inputs.observation import Observation

CLOSEST = 0.009
"""Seconds between samples, at least; of faster recordings only some samples are used."""
LAST_THIRD = " (last third)"
"""What the id of the part of a recording ends in that is held out."""
DRIVEN = 0.25
"""Commands over the strongest ones, root mean square, from which a recording is driven as these are."""


def split(
    recordings: Sequence[Recording], observation: Observation, samples: int
) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings: every third in the order of their speed; of a single one, its last third.

    If all driven recordings, or all passive ones, would be held out, one is learned from in place of its neighbour:
    what only held-out ones excite, such as the common factor of masses and forces, would be tested without having been
    learned.

    The clock of a last third goes on from the start of the recording, whose first part has no positions any more.

    Args:
        recordings: all of them.
        observation: what is measured in them.
        samples: that each part of a single recording must have.

    Raises:
        InputError: if a single recording is too short.
    """
    if len(recordings) == 1:
        return _in_time(recordings[0], samples)
    speed = [float(np.nanmean(np.abs(np.diff(observation.measured(r), axis=0)))) for r in recordings]
    order, driven = [int(i) for i in np.argsort(speed, kind="stable")], _driven(recordings)
    for kind in (driven, ~driven):
        own = {int(i) for i in np.flatnonzero(kind)}
        if own and len(order) > 2 and own <= set(order[1::3]):
            p = order.index(max(own, key=speed.__getitem__))
            order[p - 1], order[p] = order[p], order[p - 1]
    test = set(order[1::3])
    learned = [recordings[i] for i in order if i not in test]
    return learned, [recordings[i] for i in order if i in test]


def _driven(recordings: Sequence[Recording]) -> NDArray[np.bool_]:
    """Which recordings have commands of the size of the strongest ones."""
    size = np.array([0.0 if r.action is None else np.sqrt(np.mean(np.square(r.action))) for r in recordings])
    return size > DRIVEN * size.max()


def _in_time(whole: Recording, samples: int) -> tuple[list[Recording], list[Recording]]:
    """The first two thirds of a recording, and the last."""
    t = np.asarray(whole.t_state)
    k = 2 * len(t) // 3
    if len(t) - k < samples:
        raise InputError(
            f"Recording {whole.id!r} has {len(t)} samples, too few to hold some out; record at least {3 * samples}."
        )
    rest = np.array(whole.qpos)
    rest[:k] = np.nan
    return [_part(whole, slice(0, k))], [replace(whole, id=whole.id + LAST_THIRD, qpos=rest, qvel=None)]


def spacing(recordings: Sequence[Recording]) -> float:
    """Median time between samples, s."""
    return float(np.median(np.concatenate([np.diff(np.asarray(r.t_state)) for r in recordings])))


def accurate_step(recordings: Sequence[Recording]) -> float:
    """Of a simulation, s: the time between samples, or a part of it, so that it is no more than 10 ms."""
    between = spacing(recordings)
    return float(between / np.ceil(between / 0.0101))  # and what clocks are off


def ready(recordings: Sequence[Recording], model: mujoco.MjModel, samples: int) -> list[Recording]:
    """With commands for all motors, zero where none were recorded, and samples no closer than `CLOSEST`.

    Raises:
        InputError: if that leaves fewer than so many samples.
    """
    out = [thin(_commanded(recording, model)) for recording in recordings]
    for before, after in zip(recordings, out, strict=True):
        if len(np.asarray(after.t_state)) < samples:
            t = np.asarray(before.t_state)
            raise InputError(
                f"Recording {before.id!r} lasts {t[-1] - t[0]:.2g} s, of which samples {1e3 * CLOSEST:g} ms apart are "
                f"used, at least {samples}; record for longer."
            )
    return out


def thin(recording: Recording, closest: float = CLOSEST) -> Recording:
    """With samples no closer than so many seconds, nearly."""
    t = np.asarray(recording.t_state)
    every = max(1, round(closest / float(np.median(np.diff(t)))))
    return _part(recording, slice(None, None, every)) if every > 1 else recording


def uncommanded(recordings: Sequence[Recording], model: mujoco.MjModel) -> str:
    """A sentence, with a space before it, if there are motors and no recording has a command; else nothing."""
    if not model.nu or any(recording.action is not None for recording in recordings):
        return ""
    motors = ", ".join(model.actuator(i).name for i in range(model.nu))
    return f" No recording has commands (action): the simulator's motors, {motors}, count as off."


def _commanded(recording: Recording, model: mujoco.MjModel) -> Recording:
    """What has no recorded commands is passive."""
    if recording.action is not None:
        return recording
    names = tuple(model.actuator(i).name for i in range(model.nu))
    if not names:
        return replace(recording, actuator_names=())
    still = {"t_action": np.asarray(recording.t_state)[:1], "action": np.zeros((1, len(names)))}
    return replace(recording, actuator_names=names, units={**recording.units, "action": "1"}, **still)


def _part(recording: Recording, piece: slice) -> Recording:
    qvel, deviation = recording.qvel, recording.qpos_std
    return replace(
        recording,
        t_state=np.asarray(recording.t_state)[piece],
        qpos=np.asarray(recording.qpos)[piece],
        qpos_std=None if deviation is None else deviation[piece],
        qvel=None if qvel is None else qvel[piece],
    )
