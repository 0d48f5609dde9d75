"""Sparse regression of the torque that the simulator lacks (Brunton et al., 2016), in both sets; with PySINDy."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.baselines.residual import Array, ResidualTorque, torque_lacking
from keycld_control.benchmarks.blind.baselines.sindy import TERMS, Terms, features, installed
from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_control.benchmarks.real.rivals.deviations import Difference, answer, covariance, estimate
from keycld_control.benchmarks.refitting import spacing
from keycld_envs.effects import effect_class
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.verdict.report import Estimate

BLOCK = 0.5
"""Seconds of the blocks between which residuals are independent; several times as long as they are smoothed."""
LIBRARY: Terms = TERMS | {
    "sign u": (lambda q, v, u: np.tanh(u / 0.05), "actuator_dead_zone", "actuation", -1),
}
"""With what a motor with a dead zone lacks."""
SMOOTH = 0.08
"""Seconds of the cubic polynomials that give speeds and accelerations; of .08, .15 and .25, what named most on cases of
another seed."""
STEP = 0.01
"""Seconds between the samples that are regressed, at least; what was smoothed does not change faster."""
MOST = 12
"""Terms at a joint, of the mechanism and of what changed."""
NEW = "new "
"""Before the name of a term that is in the new set only."""
PARTNERS = {
    new + name: new + name.replace(a, b)
    for new in ("", NEW)
    for name in LIBRARY
    for a, b in (("sin ", "cos "), ("cos ", "sin "))
    if a in name
}
"""Terms that make up one effect."""


def sindy(new: Sequence[Recording], baseline: Sequence[Recording], model: mujoco.MjModel) -> Answer:
    """The term whose weight differs most between the sets.

    Both sets are regressed at once on all terms, and on all terms again in the new set only; sparsity decides which
    weights there are and which differ.

    Raises:
        MissingPackage: if PySINDy is not installed.
    """
    between = spacing([*new, *baseline])
    runs = [torque_lacking(model, r, between, smooth=SMOOTH) for r in [*baseline, *new]]
    differences = []
    for joint in range(model.njnt):
        motor = next((i for i in range(model.nu) if model.actuator_trnid[i, 0] == joint), -1)
        found = _differing(runs, len(baseline), joint, motor, between)
        place, motor_name = model.joint(joint).name, model.actuator(motor).name if motor >= 0 else ""
        differences += [_difference(name, found, place, motor_name) for name in found]
    return answer(differences)


def _differing(
    runs: Sequence[ResidualTorque], baseline: int, joint: int, motor: int, between: float
) -> dict[str, tuple[float, float]]:
    """Terms at a joint whose weights differ, with the difference and its variance; the first runs are the baseline."""
    every = max(1, round(STEP / between))
    step = every * between
    runs = [replace(r, **{key: getattr(r, key)[::every] for key in ("q", "v", "u", "torque")}) for r in runs]
    names, shared = features(runs, joint, motor, LIBRARY)
    torque = np.concatenate([r.torque[:, joint] for r in runs])
    number = np.concatenate([np.full(len(r.q), i) for i, r in enumerate(runs)])
    own = shared * (number >= baseline)[:, None]
    names, columns = [*names, *(NEW + n for n in names)], np.concatenate([shared, own], axis=1)
    there = np.any(columns != 0, axis=0)  # a motor may be idle in the new recordings
    names, columns = [names[i] for i in np.flatnonzero(there)], columns[:, there]
    active = {names[i] for i in _active(columns, torque, SMOOTH / step)}
    active |= {PARTNERS[name] for name in active if name in PARTNERS}
    chosen = [i for i, name in enumerate(names) if name in active]
    values = columns[:, chosen]
    weights = np.linalg.lstsq(values, torque, rcond=None)[0]
    time = np.concatenate([np.arange(len(r.q)) * step for r in runs])
    block = np.unique(np.stack([number, time // BLOCK]), axis=1, return_inverse=True)[1].ravel()
    variance = np.diag(covariance(values, torque - values @ weights, block))
    found = {names[i]: (float(w), float(v)) for i, w, v in zip(chosen, weights, variance, strict=True)}
    return {name.removeprefix(NEW): both for name, both in found.items() if name.startswith(NEW)}


def _active(columns: Array, torque: Array, together: float) -> list[int]:
    """Columns chosen one after another by orthogonal least squares, as many as the Bayesian criterion says.

    Unlike sequential thresholding, this chooses one of several columns that hardly differ.
    """
    regression = installed().FROLS(max_iter=MOST, alpha=0.0)
    regression.fit(columns / np.sqrt(np.mean(columns**2, axis=0)), torque[:, None])
    number, best, chosen = len(torque) / together, np.inf, []
    for weights in regression.history_:
        some = np.flatnonzero(weights[0])
        left = torque - columns[:, some] @ np.linalg.lstsq(columns[:, some], torque, rcond=None)[0]
        criterion = np.log(np.mean(left**2)) * number + np.log(number) * len(some)
        if criterion < best:
            best, chosen = criterion, [int(i) for i in some]
    return chosen


def _difference(name: str, found: dict[str, tuple[float, float]], joint: str, motor: str) -> Difference:
    """A term's difference as an effect; one that acts as no effect of its kind may is unknown."""
    _, effect, _, sign = LIBRARY[name]
    change, variance = found[name]
    deviations = float(abs(change) / np.sqrt(variance))
    where = motor if effect.startswith("actuator") else joint
    if effect == "unknown" or change * sign < 0:
        return Difference("unknown", where, joint, {}, deviations)
    return Difference(effect, where, joint, _parameters(name, found, sign or 1.0), deviations)


def _parameters(name: str, found: dict[str, tuple[float, float]], sign: float) -> dict[str, Estimate]:
    """An effect's parameters of its term's weight."""
    effect = LIBRARY[name][1]
    if effect == "cogging":
        sine = name if name.startswith("sin") else PARTNERS[name]
        return {p: estimate(*found[term], "N m") for p, term in (("a", sine), ("b", PARTNERS[sine]))}
    kind = effect_class(effect, "actuator" if effect.startswith("actuator") else "joint")
    if kind is None or not kind.parameters():
        return {}
    first, (change, variance) = kind.parameters()[0], found[name]
    return {first.name: estimate(first.absent + sign * change, variance, first.unit)}
