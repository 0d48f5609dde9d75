"""Refuses sets of recordings that cannot be compared."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.inputs.prepare import spacing

FARTHER, STRONGER = 20.0, 100.0
"""Times that the range of a baseline's positions and commands is exceeded by mistaken units: a radian is 57 degrees."""
FEWEST = 4
"""Windows of new recordings."""
HINGE = mujoco.mjtJoint.mjJNT_HINGE


def check_alike(recordings: Sequence[Recording], baseline: Sequence[Recording]) -> None:
    """Raise InputError if a baseline does not suit recordings of the same simulator, with both named."""
    check_runs(len(baseline))
    new, old = recordings[0], baseline[0]
    if new.joint_names != old.joint_names:
        raise InputError(
            f"Recording {new.id!r} has the joints {list(new.joint_names)}, the baseline {old.id!r} has "
            f"{list(old.joint_names)}; compare recordings of the same joints, in the same order."
        )
    if new.actuator_names != old.actuator_names:
        raise InputError(
            f"Recording {new.id!r} has the actuator_names {list(new.actuator_names)}, the baseline {old.id!r} has "
            f"{list(old.actuator_names)}; compare recordings of the same actuators, in the same order."
        )
    for signal in ("qpos", "action"):
        ours, theirs = (r.units.get(signal) for r in (new, old))
        if None not in (ours, theirs) and _by_column(ours) != _by_column(theirs):
            raise InputError(
                f"Recording {new.id!r} has {signal} in {ours!r}, the baseline {old.id!r} in {theirs!r}; convert one of "
                "them (units in meta.json)."
            )
    ours, theirs = spacing(recordings), spacing(baseline)
    if max(ours, theirs) > 4 * min(ours, theirs) and max(ours, theirs) > 0.02:
        raise InputError(
            f"The recordings, such as {new.id!r}, have a sample every {1e3 * ours:.3g} ms, the baseline, such as "
            f"{old.id!r}, every {1e3 * theirs:.3g} ms; record both at similar rates."
        )
    for r in recordings:
        for b in baseline:
            if _equal(r, b):
                what = "is in the baseline, too" if r.id == b.id else f"equals {b.id!r} of the baseline"
                raise InputError(f"The recording {r.id!r} {what}; compare with other runs.")
    _check_sizes(recordings, baseline)


def _by_column(unit: object) -> object:
    """A unit, of a signal or of each of its columns; one where they agree."""
    if not isinstance(unit, str) and isinstance(unit, Sequence) and len(set(unit)) == 1:
        return unit[0]
    return unit


def _check_sizes(recordings: Sequence[Recording], baseline: Sequence[Recording]) -> None:
    """Raise InputError if new positions or commands are so much larger that their units must be others."""
    for signal, names, most in (("qpos", "joint_names", FARTHER), ("action", "actuator_names", STRONGER)):
        values = [
            [np.asarray(x, np.float64) for r in part if (x := getattr(r, signal)) is not None]
            for part in (recordings, baseline)
        ]
        if not all(values) or not values[0][0].shape[1]:
            continue
        new, old = (np.max([np.nanmax(x, 0) - np.nanmin(x, 0) for x in part], axis=0) for part in values)
        ratio = np.where(old > 0, new / np.where(old > 0, old, 1.0), 0.0)
        if ratio.max() > most:
            j = int(ratio.argmax())
            raise InputError(
                f"Recording {recordings[0].id!r} has {signal} of {getattr(recordings[0], names)[j]!r} over a range of "
                f"{new[j]:.3g}, the baseline, such as {baseline[0].id!r}, of {old[j]:.3g}; check that both are in the "
                "same units (keycld import --unit COLUMN=deg converts)."
            )


def check_runs(number: int) -> None:
    """Raise InputError if a baseline has too few runs."""
    if number < 2:
        raise InputError(
            f"The baseline has {number} run; at least two are needed to tell change from chance, and four or more tell "
            "it well. Record the mechanism again as it was."
        )


def _equal(one: Recording, other: Recording) -> bool:
    return all(np.array_equal(np.asarray(getattr(one, x)), np.asarray(getattr(other, x))) for x in ("qpos", "action"))


def check_overlap(beyond: Mapping[str, float]) -> None:
    """Raise InputError if new recordings are nearly everywhere beyond the baseline."""
    share, worst = max((share, channel) for channel, share in beyond.items() if not channel.startswith("command"))
    if share > 0.8:
        raise InputError(
            f"For {100 * share:.0f} % of the time, the {worst} in the recordings is beyond what the "
            "baseline has; excite both alike, so that they can be compared."
        )


def check_motion(motion: Motion, baseline: NDArray[np.bool_]) -> None:
    """Raise InputError if hardly anything moves in new recordings, where it does in the baseline.

    Args:
        motion: of both.
        baseline: `[W]` its windows.
    """
    still, travel = held_still(motion, baseline), motion.travel
    if still.all():
        j = int(np.argmax(travel[baseline].max(axis=0)))
        name, unit = motion.model.joint(j).name, "rad" if motion.model.jnt_type[j] == HINGE else "m"
        old, new = (np.percentile(travel[own, j], 90) for own in (baseline, ~baseline))
        raise InputError(
            f"The recordings hardly move: {name} by {new:.2g} {unit} within a window, where the baseline moves it by "
            f"{old:.2g}; excite both alike, so that they can be compared."
        )


def held_still(motion: Motion, baseline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """`[nv]` joints that move in the baseline, and hardly in new recordings."""
    old, new = (np.percentile(motion.travel[own], 90, axis=0) for own in (baseline, ~baseline))
    return new < motion.problem.criteria.moves * old


def check_enough(comparable: NDArray[np.bool_], new: NDArray[np.bool_]) -> None:
    """Raise InputError if few windows of new recordings stay within the range of the baseline."""
    if new.sum() < FEWEST:
        raise InputError(
            f"The recordings have motion for {new.sum()} windows of some .4 s; {FEWEST} at least are needed to compare "
            "them with the baseline. Record for longer."
        )
    if comparable.sum() < max(FEWEST, 0.2 * new.sum()):
        raise InputError(
            f"Only {comparable.sum()} of {new.sum()} windows of the recordings stay within the positions and "
            "speeds of the baseline; excite both alike, so that they can be compared."
        )
