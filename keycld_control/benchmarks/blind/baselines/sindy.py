"""Sparse regression of the missing torque (Brunton et al., 2016), with PySINDy; needs the extra `sindy`."""

import warnings
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from keycld_control.benchmarks.blind.baselines.common import Setup, finding, with_effects
from keycld_control.benchmarks.blind.baselines.residual import (
    SMOOTH,
    Array,
    Law,
    LearntTorque,
    ResidualTorque,
    missing_torque,
)
from keycld_control.benchmarks.refitting import minimise
from keycld_envs.optional import optional
from keycld_envs.recordings import Recording

Terms = dict[str, tuple[Law, str, str, float]]
TERMS: Terms = {
    "1": (lambda q, v, u: np.ones_like(q), "constant_force", "force", 0),
    "q": (lambda q, v, u: q, "spring", "force", -1),
    "sin q": (lambda q, v, u: np.sin(q), "gravity_tilt", "force", 0),
    "cos q": (lambda q, v, u: np.cos(q), "gravity_tilt", "force", 0),
    "v": (lambda q, v, u: v, "viscous_friction", "dissipation", -1),
    "sign v": (lambda q, v, u: np.tanh(v / 0.05), "coulomb_friction", "dissipation", -1),
    "v abs(v)": (lambda q, v, u: v * np.abs(v), "quadratic_drag", "dissipation", -1),
    "v^3": (lambda q, v, u: v**3, "unknown", "unknown", 0),
    "sin(q) sign v": (lambda q, v, u: np.sin(q) * np.tanh(v / 0.05), "position_dependent_friction", "dissipation", 0),
    **{
        f"{name} {n}q": (lambda q, v, u, n=n, f=f: f(n * q), "cogging", "force", 0)
        for n in range(2, 9)
        for name, f in (("sin", np.sin), ("cos", np.cos))
    },
    "u": (lambda q, v, u: u, "actuator_gain", "actuation", 0),
}
"""Of position, speed and command of one joint: function, name in the taxonomy, family, and sign if it has one."""
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Of coefficients, for terms of unit size, as shares of the root mean square torque."""


def sindy(training: Sequence[Recording], held_out: Sequence[Recording], model: mujoco.MjModel) -> dict[str, Any]:
    """One regression per joint; sparsity by the Bayesian criterion.

    Raises:
        MissingPackage: if PySINDy is not installed.
    """
    setup = Setup.of(training, held_out, model)
    runs = [missing_torque(setup, r) for r in setup.training]
    motors = [next((i for i in range(model.nu) if model.actuator_trnid[i, 0] == j), -1) for j in range(model.njnt)]
    together = max(1.0, SMOOTH / setup.spacing)
    laws = [_regress(runs, j, motors[j], together) for j in range(model.njnt)]

    def law(q: Array, v: Array, u: Array) -> Array:
        out = np.zeros_like(v)
        for j, weights in enumerate(laws):
            command = u[..., motors[j]] if motors[j] >= 0 else np.zeros_like(q[..., j])
            for name, weight in weights.items():
                out[..., j] += weight * TERMS[name][0](q[..., j], v[..., j], command)
        return out

    named: dict[tuple[str, str], dict[str, Any]] = {}
    for j, weights in enumerate(laws):
        for name, weight in weights.items():
            _, effect, family, sign = TERMS[name]
            if sign * weight > 0 or not sign:
                kind, place = "joint", model.joint(j).name
                if effect == "gravity_tilt":
                    kind, place = "world", "world"
                elif effect == "actuator_gain":
                    kind, place = "actuator", model.actuator(motors[j]).name
            else:
                effect, family, kind, place = "unknown", "unknown", "joint", model.joint(j).name
            terms = {f"{name} at {model.joint(j).name}": {"value": weight, "unit": "N m"}}
            one = named.setdefault((effect, place), finding(effect, family, kind, place, {}))
            one["parameters"] |= terms
    corrected = with_effects(setup.refitted.point.variant, LearntTorque.of(law, runs))
    problem = setup.refitted.problem
    fit = minimise(problem, setup.refitted.point.with_effects(*corrected.effects), 4, only_states=True)
    return setup.report("mismatch" if named else "no_mismatch", list(named.values()), corrected, fit.chi_square)


def features(runs: Sequence[ResidualTorque], joint: int, motor: int, terms: Terms = TERMS) -> tuple[list[str], Array]:
    """Names of the terms at a joint, whose motor is -1 if it has none, and their values `[N, terms]`."""
    q, v = (np.concatenate([getattr(r, key)[:, joint] for r in runs]) for key in ("q", "v"))
    u = np.concatenate([r.u[:, motor] if motor >= 0 else np.zeros(len(r.q)) for r in runs])
    names = [name for name in terms if not name.endswith("u") or np.ptp(u) > 0]
    return names, np.stack([terms[name][0](q, v, u) for name in names], axis=1)


def installed() -> Any:
    """PySINDy.

    Raises:
        MissingPackage: if it is not installed.
    """
    return optional("pysindy", "sindy", "Baselines by SINDy")


def _regress(runs: Sequence[ResidualTorque], joint: int, motor: int, together: float) -> dict[str, float]:
    """Active terms and their weights, N m or N; as many samples as were smoothed `together` count as one."""
    pysindy = installed()
    torque = np.concatenate([r.torque[:, joint] for r in runs])
    names, values = features(runs, joint, motor)
    size, scale = np.sqrt(np.mean(values**2, axis=0)), float(np.sqrt(np.mean(torque**2)))
    if scale == 0:
        return {}
    number = len(torque) / together
    best, chosen = np.log(np.mean(torque**2)) * number, {}
    for threshold in THRESHOLDS:
        sparse = pysindy.STLSQ(threshold=threshold, alpha=1e-3, max_iter=50)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of thresholds that leave nothing
            sparse.fit(values / size, (torque / scale)[:, None])
        weights = np.asarray(sparse.coef_)[0] * scale / size
        left = np.mean((torque - values @ weights) ** 2)
        criterion = np.log(left) * number + np.log(number) * np.count_nonzero(weights)
        if criterion < best:
            best = criterion
            chosen = {name: float(w) for name, w in zip(names, weights, strict=True) if w}
    return chosen
