"""The recording to make next: of a menu of motions, the one that would best tell apart what these recordings cannot."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.recordings import Recording
from keycld_model.delan.rig import learned_dynamics
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.parameters import effect_parameters
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.prepare import spacing
from keycld_model.diagnosis.inputs.windows import Windows, cut
from keycld_model.diagnosis.verdict.drive import Drive
from keycld_model.diagnosis.verdict.report import Experiment

Array = NDArray[np.float64]
FASTEST = 15.0
"""Rad/s or m/s; nothing that moves faster is proposed, unless the recordings were faster."""


@dataclass(frozen=True)
class _Motion:
    """Something to do: from a pose at rest, with commands.

    Attributes:
        kind: of the place, "joint" or "actuator".
        name: of the place.
        action: a phrase.
        pose: `[nv]` rad or m.
        commands: `[N, nu]`, one per sample.
        drive: the commands of that place.
    """

    kind: str
    name: str
    action: str
    pose: Array
    commands: Array
    drive: Drive


def next_experiment(truth: Fit, rivals: Sequence[tuple[str, Fit]], n: int) -> Experiment | None:
    """The motion in which the least different of the rivals differs most from what is believed.

    What a rival would have to leave of the motion that is believed is counted with its own numbers free within what
    the recordings say of them, and initial states free, to first order (Box and Hill, 1967, for two models with
    Gaussian errors).

    Args:
        truth: what is believed.
        rivals: by name, what is not excluded.
        n: samples of the motion; the time between them is that of the recordings.

    Returns:
        The experiment, which is not decisive where none tells them apart; None where nothing can be released or
        driven.
    """
    model, problem, recordings = truth.problem.simulator.model, truth.problem, truth.problem.windows.recordings
    motions = list(_motions(model, recordings, n))
    if not motions:
        return None
    windows = _windows(motions, problem.windows, n)
    pose = np.stack([m.pose for m in motions])
    at_rest = Point(truth.point.variant.for_other_recordings(), pose, np.zeros_like(pose))
    predicted = replace(problem, windows=windows).predicted(at_rest)
    trial = replace(problem, windows=replace(windows, measured=predicted))
    told = np.min([_told(trial, at_rest, fit) for _, fit in rivals], axis=0)
    told[~_safe(predicted, windows.time, recordings)] = 0.0
    best = int(np.argmax(told))
    chosen, nats = motions[best], float(told[best])
    seconds = float(windows.time[best, -1] - windows.time[best, 0])
    return Experiment(
        where={"kind": chosen.kind, "name": chosen.name},
        action=f"{chosen.action}, for {seconds:.2g} s",
        start=dict(zip((model.joint(j).name for j in range(model.njnt)), chosen.pose.round(3).tolist(), strict=True)),
        nats=round(nats, 1),
        against=[name for name, _ in rivals],
        decisive=nats > problem.criteria.doubtful,
        drive=chosen.drive,
    )


def _told(trial: Problem, point: Point, rival: Fit) -> Array:
    """Nats per motion that a rival would lose on it, `[W]`."""
    linear, _ = trial.linearise(replace(point, variant=rival.point.variant.for_other_recordings()))
    numbers = len(trial.spreads) + len(effect_parameters(rival.effects))
    residual, shared = linear.project(linear.residual[..., None])[..., 0], linear.project(linear.shared[..., :numbers])
    pull = np.einsum("wri,wr->wi", shared, residual)
    hessian = np.einsum("wri,wrj->wij", shared, shared) + rival.hessian[:numbers, :numbers]
    hessian += 1e-9 * np.eye(numbers)
    explained = np.einsum("wi,wi->w", pull, np.linalg.solve(hessian, pull[..., None])[..., 0])
    return 0.5 * np.maximum(np.sum(residual**2, axis=1) - explained, 0.0)


def _safe(predicted: Array, time: Array, recordings: Sequence[Recording]) -> NDArray[np.bool_]:
    """Motions `[W, n, nv]` that are not too fast."""
    recorded = 0.0
    for r in recordings:
        moved, passed = np.diff(np.asarray(r.qpos), axis=0), np.diff(np.asarray(r.t_state))
        speeds = np.abs(moved[passed > 0] / passed[passed > 0, None])
        recorded = max(recorded, float(np.max(speeds, initial=0.0, where=np.isfinite(speeds))))
    speed = np.abs(np.diff(predicted, axis=1) / np.diff(time, axis=1)[..., None]).max(axis=(1, 2))
    return np.isfinite(speed) & (speed < max(FASTEST, recorded))


def _motions(model: mujoco.MjModel, recordings: Sequence[Recording], n: int) -> Iterator[_Motion]:
    commanded = len(recordings[0].actuator_names)
    rest, still = _rest(model, recordings), np.zeros((n, commanded))
    for j in range(model.njnt):
        turns = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        for size in (
            () if model.neq else (0.3, 1.0, 2.5) if turns else (0.05, 0.2, 0.5)
        ):  # a loop does not let one joint move
            pose = rest.copy()
            pose[j] += size
            away = f"{size:g} {'rad' if turns else 'm'} from rest"
            yield _Motion("joint", model.joint(j).name, f"release it {away}", pose, still, Drive())
    t = spacing(recordings) * np.arange(n, dtype=np.float64)
    for i in range(commanded):
        used = max((float(np.abs(r.action[:, i]).max()) for r in recordings if r.action is not None), default=0.0)
        limit = float(np.abs(model.actuator_ctrlrange[i]).max()) if model.actuator_ctrllimited[i] else np.inf
        for size in sorted({min(limit, a * (used or min(limit, 1.0))) for a in (0.25, 1.0, 2.0)}):
            for drive in (Drive("sine", size, 0.4), Drive("sine", size, 2.0), Drive("steps", size, 2.5)):
                commands = still.copy()
                commands[:, i] = drive.commands(t)
                yield _Motion("actuator", model.actuator(i).name, f"drive it with {drive}", rest, commands, drive)


def _rest(model: mujoco.MjModel, recordings: Sequence[Recording]) -> Array:
    """The recorded pose with the least potential energy, `[nv]`."""
    data, poses, learned = mujoco.MjData(model), [], learned_dynamics(model)
    for r in recordings:
        q = np.asarray(r.qpos)
        poses.extend(q[np.isfinite(q).all(axis=1)][:: max(1, len(q) // 50)])

    def energy(pose: Array) -> float:
        if learned is not None:
            return float(learned.model.potential_energy(pose))
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        return float(-np.sum(model.body_mass[:, None] * data.xipos * model.opt.gravity))

    return np.array(min(poses, key=energy))


def _windows(motions: Sequence[_Motion], windows: Windows, n: int) -> Windows:
    """One window per motion."""
    recordings = windows.recordings
    t = spacing(recordings) * np.arange(n)
    planned = [
        replace(
            recordings[0],
            id=f"planned {i}",
            t_state=t,
            qpos=np.repeat(m.pose[None], n, axis=0),
            qvel=None,
            t_action=t if m.commands.shape[1] else None,
            action=m.commands if m.commands.shape[1] else None,
            qpos_std=None,
            t_frame=None,
            keypoints=None,
            keypoint_covariance=None,
            pivot=None,
            frames=None,
            video=None,
        )
        for i, m in enumerate(motions)
    ]
    return cut(planned, windows.observation, windows.step, n)
