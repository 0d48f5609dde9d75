"""Recordings made ready: some held out, and none sampled faster than is useful."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording

SAMPLES = 40
"""Per window."""
FASTEST = 0.009
"""Seconds between samples, at least; of faster recordings only some samples are used."""
STEP = 0.0101
"""Seconds per step of an accurate simulation, at most: 10 ms, and what clocks are off."""


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings: every third in the order of their speed; of a single one, its last third."""
    if len(recordings) == 1:
        whole = recordings[0]
        t = np.asarray(whole.t_state)
        k = 2 * len(t) // 3
        if len(t) - k < SAMPLES:
            raise InputError(
                f"Recording {whole.id!r} has {len(t)} samples, too few to hold some out; record at least {3 * SAMPLES}."
            )
        return [_part(whole, slice(0, k), "")], [_part(whole, slice(k, None), " (last third)")]
    speed = [np.nanmean(np.abs(np.diff(np.asarray(r.qpos), axis=0))) for r in recordings]
    order = [recordings[i] for i in np.argsort(speed, kind="stable")]
    return [r for i, r in enumerate(order) if i % 3 != 1], order[1::3]


def spacing(recordings: Sequence[Recording]) -> float:
    """Median time between samples, s."""
    return float(np.median(np.concatenate([np.diff(np.asarray(r.t_state)) for r in recordings])))


def accurate_step(recordings: Sequence[Recording]) -> float:
    """Of a simulation, s: the time between samples, or a part of it, so that it is no more than `STEP`."""
    between = spacing(recordings)
    return float(between / np.ceil(between / STEP))


def thin(recording: Recording) -> Recording:
    """With samples no closer than `FASTEST`."""
    t = np.asarray(recording.t_state)
    every = max(1, round(FASTEST / float(np.median(np.diff(t)))))
    return _part(recording, slice(None, None, every), "") if every > 1 else recording


def _part(recording: Recording, piece: slice, suffix: str) -> Recording:
    qvel = recording.qvel
    return replace(
        recording,
        id=recording.id + suffix,
        t_state=np.asarray(recording.t_state)[piece],
        qpos=np.asarray(recording.qpos)[piece],
        qvel=None if qvel is None else qvel[piece],
    )
