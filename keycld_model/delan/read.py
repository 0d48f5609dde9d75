"""Motions of joints from files: archives of arrays, and recordings."""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.reading import read_arrays
from keycld_envs.recordings import Recording, read_dataset, read_recording
from keycld_model.delan.config import Kind
from keycld_model.delan.filtering import low_pass
from keycld_model.delan.motions import Motion, Motions
from keycld_model.delan.smoothing import Smoothed, smooth

Floats = NDArray[np.float64]
SHORTEST = 16
"""Samples that a motion must have at least where velocities or accelerations are estimated."""
COARSE = 0.1
"""Largest error, as a share of a joint's standard deviation, with which every second sample may predict the others:
beyond, the motion between samples, and so the acceleration, is a guess."""
DEGREES = (180 / np.pi / 1.25, 180 / np.pi * 1.25)
"""Ratio of differentiated to measured velocities at which one of both is in degrees."""
MOST_TURNS = 4 * np.pi
"""rad; positions of a hinge beyond may be degrees, as `keycld import` has it."""
TORQUES = ("N m", "N")
"""Units of commands that are torques."""


def read_motions(
    path: str | os.PathLike[str], slides: Sequence[str] = (), radians: bool = False, band: float | None = None
) -> Motions:
    """Read motions of joints.

    Args:
        path: an .npz archive with `qp`, `tau`, and any of `t`, `qv`, `qa`, all `[N, n]` but the clock, with `labels`
            and `lengths` of the motions one after another, and true parts `m`, `c`, `g` of the torques; a folder of
            recordings; or one recording.
        slides: names of joints that slide, for archives, which call joints joint_1, joint_2 and so on.
        radians: positions of an archive are in radians, although they may as well be degrees.
        band: Hz, below which signals of recordings are looked at; see `motions_of`.

    Raises:
        InputError: if there is no such file, or something is missing or makes no sense.
    """
    path = Path(path)
    if path.suffix == ".npz":
        if band is not None:
            raise InputError(f"{path} is an archive, which is taken as it is; name a band for recordings and logs.")
        return _archive(path, slides, radians)
    if (path / "meta.json").is_file():
        return motions_of(str(path), [read_recording(path)], band)
    if path.is_dir():
        return motions_of(str(path), read_dataset(path).recordings, band)
    raise InputError(
        f"{path} is neither an .npz archive nor a folder of recordings; `keycld import` makes a recording of a log."
    )


def _archive(path: Path, slides: Sequence[str], radians: bool) -> Motions:
    try:
        arrays = read_arrays(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}).") from error
    if missing := [name for name in ("qp", "tau") if name not in arrays]:
        what = {"qp": "positions", "tau": "torques"}[missing[0]]
        raise InputError(f"{path} has no {missing[0]}, the {what}; there are {', '.join(arrays)}.")
    signals = {
        name: _numbers(path, name, arrays) for name in ("qp", "qv", "qa", "tau", "m", "c", "g") if name in arrays
    }
    number, n = signals["qp"].shape
    joints = tuple(f"joint_{j + 1}" for j in range(n))
    if unknown := [name for name in slides if name not in joints]:
        raise InputError(f"{path} has no joint {unknown[0]!r}; its joints are {', '.join(joints)}.")
    kinds: tuple[Kind, ...] = tuple("slide" if name in slides else "hinge" for name in joints)
    if "t" not in arrays and not {"qv", "qa"} <= set(arrays):
        raise InputError(f"{path} has no clock t, from which velocities and accelerations could follow; add it.")
    t, lengths, labels = _parted(path, arrays, number)
    ends = np.cumsum(lengths)
    motions = []
    for label, start, end in zip(labels, ends - lengths, ends, strict=True):
        piece = slice(start, end)
        x = {name: signal[piece] for name, signal in signals.items()}
        truth = {long: x[name] for name, long in (("m", "inertial"), ("c", "coriolis"), ("g", "gravity")) if name in x}
        name = f"{path}, motion {label!r}"
        motions.append(_motion(name, label, t[piece], x["qp"], x.get("qv"), x.get("qa"), x["tau"], joints, truth))
    _check_degrees(str(path), joints, kinds, motions)
    for name, kind, q in zip(joints, kinds, signals["qp"].T, strict=True):
        if kind == "hinge" and np.abs(q).max() > MOST_TURNS and not radians:
            raise InputError(
                f"{path}: positions of {name!r} reach {np.abs(q).max():.4g}, which may be degrees; convert them to "
                "radians, or, if the joint turns so often, say --radians."
            )
    return Motions(str(path), joints, kinds, tuple(motions))


def _parted(path: Path, arrays: Mapping[str, NDArray], number: int) -> tuple[Floats, NDArray[np.int_], list[str]]:
    """Clock `[N]`, and number of samples and name of each motion.

    Raises:
        InputError: if they are none, or do not belong to so many samples.
    """
    t, lengths = (np.asarray(arrays.get(name, default)).ravel() for name, default in _alone(number).items())
    for name, array in (("t", t), ("lengths", lengths)):
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds {array.dtype} that are not all finite numbers; correct it.")
    if (lengths < 1).any() or (lengths % 1 != 0).any():
        raise InputError(f"{path}: lengths are numbers of samples, 1 at least; correct {lengths.tolist()[:20]}.")
    labels = [str(label) for label in np.asarray(arrays.get("labels", ["all"])).ravel()]
    if lengths.sum() != number or len(t) != number or len(labels) != len(lengths) or len(set(labels)) < len(labels):
        raise InputError(f"{path}: labels, lengths and t do not part its {number} samples into named motions.")
    return t.astype(np.float64), lengths.astype(int), labels


def _alone(number: int) -> dict[str, NDArray]:
    """Clock and lengths of an archive that has none: one motion."""
    return {"t": np.arange(number), "lengths": np.array([number])}


def _numbers(path: Path, name: str, arrays: Mapping[str, NDArray]) -> Floats:
    array, shape = np.asarray(arrays[name]), np.asarray(arrays["qp"]).shape
    if array.dtype.kind not in "fiu" or array.ndim != 2 or array.shape != shape or not array.size:
        raise InputError(
            f"{path}: {name} is {array.dtype} of shape {list(array.shape)}; it must be numbers [N, n] as qp."
        )
    if len(bad := np.flatnonzero(~np.isfinite(array).all(axis=1))):
        raise InputError(f"{path}: {name}[{bad[0]}] is not finite; leave the sample out.")
    return array.astype(np.float64)


def motions_of(source: str, recordings: Sequence[Recording], band: float | None = None) -> Motions:
    """Motions of recordings; actions are torques, and reach samples as their mean around each.

    Args:
        source: of the recordings, for messages.
        recordings: of the same joints.
        band: Hz; if given, all signals are low-passed there, and accelerations follow from what is left. For links
            that vibrate; see `filtering`.

    Raises:
        InputError: if joints, torques or units are missing or differ, or rates are too low for accelerations.
    """
    first = recordings[0]
    joints = first.joint_names
    motions = []
    for recording in recordings:
        where = f"{source}, recording {recording.id!r}"
        if recording.joint_names != joints:
            raise InputError(f"{where} has the joints {list(recording.joint_names)}, {first.id!r} has {list(joints)}.")
        if recording.qpos is None or recording.t_state is None:
            raise InputError(f"{where} has no qpos; joint models learn from joints.")
        t, keep = np.unique(recording.t_state, return_index=True)
        q = recording.qpos[keep]
        v = None if recording.qvel is None or np.isnan(recording.qvel[keep]).any() else recording.qvel[keep]
        tau = _torques(where, recording, t)
        if band is not None:
            motions.append(low_pass(where, recording.id, t, q, v, tau, band))
            continue
        motion = _motion(where, recording.id, t, q, v, None, tau, joints, {})
        motions.append(motion.part(np.flatnonzero(np.isfinite(q).all(axis=1)), recording.id))
    kinds: tuple[Kind, ...] = tuple(_kind(first, j) for j in range(len(joints)))
    _check_degrees(source, joints, kinds, motions)
    return Motions(source, joints, kinds, tuple(motions))


def _kind(recording: Recording, joint: int) -> Kind:
    unit = recording.units.get("qpos", "rad")
    return "slide" if (unit if isinstance(unit, str) else unit[joint]) == "m" else "hinge"


def _torques(where: str, recording: Recording, t: Floats) -> Floats:
    """Mean torque of each joint around each sample `[T, n]`."""
    joints = recording.joint_names
    if recording.action is None:
        raise InputError(f"{where} has no actions; joint models need the torques, import them with --action.")
    columns, factors = motors_of(where, recording)
    middle = (t[1:] + t[:-1]) / 2
    edges = np.concatenate([[t[0]], middle, [t[-1]]])
    edges = np.maximum(edges, np.asarray(recording.t_action)[0])
    tau = np.zeros((len(t), len(joints)))
    later = np.flatnonzero(np.diff(edges) > 0)
    means = recording.mean_actions(np.append(edges[later], edges[-1]))
    tau[later[:, None], columns] = means * factors
    tau[: later[0]] = tau[later[0]]
    return tau


def motors_of(where: str, recording: Recording) -> tuple[list[int], list[float]]:
    """Joint of each actuator, which has the joint's name or its place, and torque of one unit of its command.

    Raises:
        InputError: if actuators belong to no joints, or commands are no torques.
    """
    joints, names = recording.joint_names, recording.actuator_names
    if set(names) <= set(joints):
        columns = [joints.index(name) for name in names]
    elif len(names) == len(joints):
        columns = list(range(len(joints)))
    else:
        raise InputError(
            f"{where} has the actuators {list(names)} for the joints {list(joints)}; name each actuator like its joint."
        )
    units = recording.units.get("action", "N m")
    return columns, [_factor(where, unit) for unit in ([units] * len(names) if isinstance(units, str) else units)]


def _factor(where: str, unit: str) -> float:
    """What one of a command is worth in N m or N: 2 of the unit "2 N m"."""
    found = re.fullmatch(r"\s*([-+0-9.eE]*)\s*(N m|N)\s*", unit)
    if found is not None:
        with suppress(ValueError):
            return float(found[1] or 1.0)
    raise InputError(f"{where} has actions in {unit!r}; torques are in {' or '.join(TORQUES)}, so convert them first.")


def _motion(
    where: str,
    id: str,
    t: Floats,
    q: Floats,
    v: Floats | None,
    a: Floats | None,
    tau: Floats,
    joints: Sequence[str],
    truth: dict[str, Floats],
) -> Motion:
    """A motion whose velocities and accelerations are measured or estimated.

    Raises:
        InputError: if its clock does not increase, or it cannot be estimated from.
    """
    zero = np.zeros_like(q)
    if (np.diff(t) <= 0).any():
        raise InputError(f"{where}: the clock does not increase; sort the samples.")
    if v is not None and a is not None:
        return Motion(id, t, q, v, a, tau, zero, zero, truth)
    smoothed = _smoothed(where, t, q, joints)
    if v is None:
        return Motion(id, t, smoothed.q, smoothed.v, smoothed.a, tau, smoothed.v_std, smoothed.a_std, truth)
    return Motion(id, t, q, v, smoothed.a, tau, zero, smoothed.a_std, truth)


def _smoothed(where: str, t: Floats, q: Floats, joints: Sequence[str]) -> Smoothed:
    """Smooth positions, or say that there are too few.

    Raises:
        InputError: if there are too few samples, or too few per second for accelerations.
    """
    if len(t) < SHORTEST or (np.isfinite(q).sum(axis=0) < SHORTEST).any():
        raise InputError(f"{where} has fewer than {SHORTEST} positions, too few to estimate accelerations from.")
    thinned = q.copy()
    thinned[1::2] = np.nan
    left = np.isfinite(q[1:-1:2])
    errors = np.where(left, smooth(t, thinned).q[1:-1:2] - np.nan_to_num(q[1:-1:2]), 0.0)
    rms = np.sqrt(np.sum(errors**2, axis=0) / np.maximum(left.sum(axis=0), 1))
    share = rms / np.maximum(np.nanstd(q, axis=0), 1e-12)
    moves = np.nanmax(q, axis=0) - np.nanmin(q, axis=0) > 1e-9
    if (bad := np.flatnonzero(moves & (share > COARSE))).size:
        rate = (len(t) - 1) / (t[-1] - t[0])
        raise InputError(
            f"{where}: {rate:.3g} samples/s are too few, or too noisy, for accelerations of joint "
            f"{joints[bad[0]]!r} (every second one predicts the others with an error of {share[bad[0]]:.0%}); record "
            "faster."
        )
    return smooth(t, q)


def _check_degrees(source: str, joints: Sequence[str], kinds: Sequence[Kind], motions: Sequence[Motion]) -> None:
    """Refuse hinges whose positions or velocities are in degrees.

    Raises:
        InputError: if velocities are not the derivative of positions by a factor of degrees, or positions are so large.
    """
    for j, (name, kind) in enumerate(zip(joints, kinds, strict=True)):
        if kind == "slide":
            continue
        slope = np.concatenate([np.gradient(m.q[:, j], m.t) for m in motions if len(m.t) > 2] or [np.zeros(1)])
        speed = np.concatenate([m.v[:, j] for m in motions if len(m.t) > 2] or [np.zeros(1)])
        ratio = np.sqrt(np.mean(slope**2)) / max(float(np.sqrt(np.mean(speed**2))), 1e-12)
        for value, what in ((ratio, "positions"), (1 / max(ratio, 1e-12), "velocities")):
            if DEGREES[0] < value < DEGREES[1]:
                raise InputError(f"{source}: {what} of joint {name!r} are in degrees; convert them to radians.")
