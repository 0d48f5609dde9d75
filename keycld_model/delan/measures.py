"""How good a joint model is on motions that it has not seen."""

from dataclasses import dataclass

import numpy as np

from keycld_envs.errors import InputError
from keycld_model.delan.model import JointModel
from keycld_model.delan.motions import Floats, Motion, Motions

VALID = 1e-2
"""Squared error of positions over their variance, mean of the joints, at which a rollout is no longer valid, as in the
published figures."""
STEADY = 0.05
"""Share by which a clock's intervals may differ; others are brought to a steady clock."""


@dataclass(frozen=True)
class Scores:
    """Errors on motions; squared errors are means over samples of sums over joints, as published.

    Attributes:
        torque: of `inverse_dynamics`, (N m)^2.
        torque_share: of the same over the variance of each joint's torque, mean of the joints.
        inertial: of `decompose`, (N m)^2; None where the truth is not known.
        coriolis: the same.
        gravity: the same.
        power: of `power` against torque times velocity, W^2.
        acceleration_share: of `forward_dynamics`, over the variance of each joint's acceleration, mean of the joints.
        valid_time: mean time from a motion's start for which a rollout under its torques is valid, s; see `VALID`. One
            that is valid to the end counts with its length.
        valid_times: of each motion.
        indefinite: share of samples at which inertias are not positive definite: accelerations and rollouts mean
            nothing there. None of feed-forward networks.
    """

    torque: float
    torque_share: float
    inertial: float | None
    coriolis: float | None
    gravity: float | None
    power: float
    acceleration_share: float
    valid_time: float
    valid_times: tuple[float, ...]
    indefinite: float | None


def score(model: JointModel, motions: Motions) -> Scores:
    """Measure a model.

    Raises:
        InputError: if the model is of other joints.
    """
    check_joints(model, motions)
    q, v, a, tau = (motions.all(name) for name in ("q", "v", "a", "tau"))
    found = model.inverse_dynamics(q, v, a)
    parts = model.decompose(q, v, a)
    errors = {name: _squares(getattr(parts, name), motions.truth(name)) for name in ("inertial", "coriolis", "gravity")}
    valid = tuple(valid_time(model, motion) for motion in motions.motions)
    return Scores(
        torque=float(np.mean(np.sum((found - tau) ** 2, axis=1))),
        torque_share=variance_share(found, tau),
        **errors,
        power=float(np.mean((model.power(q, v, a) - np.sum(tau * v, axis=1)) ** 2)),
        acceleration_share=variance_share(model.forward_dynamics(q, v, tau), a),
        valid_time=float(np.mean(valid)),
        valid_times=valid,
        indefinite=indefinite(model, q) if model.conserves else None,
    )


def indefinite(model: JointModel, q: Floats) -> float:
    """Share of positions `[N, n]` at which inertias are not positive definite."""
    inertias = model.mass_matrix(q)
    return float(np.mean(np.linalg.eigvalsh((inertias + np.swapaxes(inertias, 1, 2)) / 2)[:, 0] <= 0))


def check_joints(model: JointModel, motions: Motions) -> None:
    """Refuse motions of other joints.

    Raises:
        InputError: if their number or kinds differ.
    """
    if motions.kinds != model.config.kinds:
        raise InputError(
            f"{motions.source} has {len(motions.joints)} joint(s) ({', '.join(motions.kinds)}), the model has "
            f"{model.config.n} ({', '.join(model.config.kinds)}); name data of the joints that it was trained on."
        )


def valid_time(model: JointModel, motion: Motion) -> float:
    """Seconds from the start for which a rollout under the motion's torques, each held until the next, is valid."""
    t, q, v, tau = steady(motion)
    if len(t) < 2:
        return 0.0
    path, _ = model.rollout(q[0], v[0], tau, float(t[1] - t[0]))
    variance = np.array(model.config.scales.position) ** 2
    error = np.mean((path - q) ** 2 / variance, axis=1)
    wrong = np.flatnonzero(~(error < VALID))
    return float(t[wrong[0] if wrong.size else -1] - t[0])


def steady(motion: Motion) -> tuple[Floats, Floats, Floats, Floats]:
    """Clock, positions, velocities and torques at equal intervals."""
    gaps = np.diff(motion.t)
    if not len(gaps) or np.ptp(gaps) <= STEADY * np.median(gaps):
        return motion.t, motion.q, motion.v, motion.tau
    step = float(np.median(gaps))
    t = motion.t[0] + step * np.arange(int((motion.t[-1] - motion.t[0]) / step) + 1)
    signals = (np.stack([np.interp(t, motion.t, x) for x in s.T], axis=1) for s in (motion.q, motion.v, motion.tau))
    q, v, tau = signals
    return t, q, v, tau


def _squares(found: Floats, true: Floats | None) -> float | None:
    return None if true is None else float(np.mean(np.sum((found - true) ** 2, axis=1)))


def variance_share(found: Floats, true: Floats) -> float:
    """Mean over joints that vary of squared errors over variances."""
    variance = true.var(axis=0)
    varies = variance > 1e-12 * max(float(variance.max()), 1e-300)
    return float(np.mean(np.mean((found - true) ** 2, axis=0)[varies] / variance[varies]))
