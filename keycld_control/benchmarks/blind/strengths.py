"""Draws mechanisms: sizes log-uniform, so that most are clear, some marginal, and a few hidden."""

from collections.abc import Callable
from math import pi, sqrt

import numpy as np

from keycld_control.benchmarks.blind.mechanism import CaseMechanism
from keycld_control.benchmarks.blind.mechanisms import actuation, forces, friction, measurement, structure
from keycld_control.benchmarks.blind.sites import Site

Draw = Callable[[Site, np.random.Generator, bool], CaseMechanism]
"""Draws the parameters of a mechanism at a site; the last argument tells whether motors are driven."""


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def _viscous(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return friction.Viscous(s.joint, -1, s.torque / s.speed * log_uniform(rng, 0.002, 0.15))


def _drag(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return friction.Drag(s.joint, -1, s.torque / s.speed**2 * log_uniform(rng, 0.003, 0.15))


def _coulomb(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return friction.Coulomb(s.joint, -1, s.torque * log_uniform(rng, 0.002, 0.1))


def _stribeck(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    c = s.torque * log_uniform(rng, 0.005, 0.07)
    return friction.Stribeck(s.joint, -1, c, c * float(rng.uniform(1.5, 3)), s.speed * log_uniform(rng, 0.05, 0.3))


def _load(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return friction.LoadDependent(s.joint, -1, s.torque / s.load * log_uniform(rng, 0.003, 0.1))


def _asymmetric(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    c, ratio = s.torque * log_uniform(rng, 0.004, 0.08), float(rng.uniform(1.25, 2)) ** sign(rng)
    return friction.Asymmetric(s.joint, -1, c * ratio, c / ratio)


def _position(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    steepest = float(rng.choice([0.0, pi])) - s.rest  # at the place where the joint is most
    phase = steepest + float(rng.uniform(-0.7, 0.7))
    return friction.PositionDependent(
        s.joint, -1, s.torque * log_uniform(rng, 0.005, 0.1), float(rng.uniform(0.5, 1)), phase % (2 * pi)
    )


def _hysteretic(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    c = s.torque * log_uniform(rng, 0.005, 0.12)
    stiffness = c / float(rng.uniform(0.02, 0.12)) * (3 if s.slide else 1)
    damping = 0.4 * sqrt(stiffness * s.inertia)
    return friction.LuGre(s.joint, -1, c, c * float(rng.uniform(1, 1.5)), 0.1 * s.speed, stiffness, damping)


def _gain(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return actuation.Gain(s.joint, s.joint, 1 + sign(rng) * log_uniform(rng, 0.01, 0.5))


def _saturation(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return actuation.Saturation(s.joint, s.joint, s.command * float(rng.uniform(0.35, 0.95)))


def _dead_zone(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return actuation.DeadZone(s.joint, s.joint, s.command * log_uniform(rng, 0.01, 0.35))


def _lag(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return actuation.Lag(s.joint, s.joint, log_uniform(rng, 0.003, 0.08))


def _delay(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return actuation.Delay(s.joint, s.joint, log_uniform(rng, 0.003, 0.06))


def _spring(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return forces.LinearSpring(
        s.joint, -1, s.torque * log_uniform(rng, 0.005, 0.5), s.rest + float(rng.uniform(-0.6, 0.6))
    )


def _constant(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return forces.Constant(s.joint, -1, sign(rng) * s.torque * log_uniform(rng, 0.003, 0.15))


def _tilt(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return forces.Tilt(-1, -1, sign(rng) * log_uniform(rng, 0.003, 0.15))


def _cogging(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    n = float(rng.uniform(4, 20)) if s.slide else float(rng.integers(3, 13))
    return forces.TorqueRipple(s.joint, -1, s.torque * log_uniform(rng, 0.005, 0.2), n, float(rng.uniform(0, 2 * pi)))


def _pulse(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return forces.Pushes(
        s.joint, -1, s.torque * log_uniform(rng, 0.03, 0.8), float(rng.uniform(0.08, 0.4)), rng.random() < 0.5
    )


def _periodic(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return forces.Periodic(
        s.joint, -1, s.torque * log_uniform(rng, 0.005, 0.25), log_uniform(rng, 2, 20), float(rng.uniform(0, 2 * pi))
    )


def _inertia(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    if s.slide or rng.random() < 0.5:
        return structure.Rotor(s.joint, -1, s.inertia * log_uniform(rng, 0.02, 0.8))
    return structure.PointMass(s.joint, -1, s.mass * log_uniform(rng, 0.02, 0.8), float(rng.uniform(0.4, 1.0)))


def _base(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    w = log_uniform(rng, 3, 15)
    return forces.BaseVibration(
        -1, -1, log_uniform(rng, 0.02, 1.2) / w**2, w, float(rng.uniform(0, 2 * pi)), rng.random() < 0.4
    )


def _backlash(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    rotor = s.inertia * float(rng.uniform(0.05, 0.2))
    k = 1e4 * rotor
    half = log_uniform(rng, 0.003, 0.1) * (0.4 if s.slide else 1)
    return structure.GearPlay(s.joint, s.joint, rotor, half, k, 0.4 * sqrt(k * rotor))


def _flexible(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    rotor, k = s.inertia * float(rng.uniform(0.1, 0.4)), s.inertia * log_uniform(rng, 10, 70) ** 2
    return structure.Flexible(s.joint, s.joint, rotor, k, 0.06 * sqrt(k * rotor))


def _stop(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    side, k = sign(rng), s.torque * log_uniform(rng, 0.3, 30)
    at = s.rest + side * s.swing * float(rng.uniform(0.2, 0.7))
    return forces.CompliantStop(s.joint, -1, k, at, side, 0.2 * sqrt(k * s.inertia))


def _latency(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return measurement.Latency(-1, -1, log_uniform(rng, 0.002, 0.06))


def _clock(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return measurement.Drift(-1, -1, sign(rng) * log_uniform(rng, 0.001, 0.04))


def _parameter_drift(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    kind = rng.choice(["friction", "mass", *(["gain"] if driven else [])])
    if kind == "friction":
        return measurement.ChangingParameter(s.joint, -1, "friction", s.torque / s.speed * log_uniform(rng, 0.01, 0.4))
    if kind == "gain":
        return measurement.ChangingParameter(s.joint, s.joint, "gain", log_uniform(rng, 0.05, 0.6))
    return measurement.ChangingParameter(s.joint, -1, "mass", log_uniform(rng, 0.03, 0.5))


LIBRARY: dict[str, Draw] = {
    "viscous_friction": _viscous,
    "coulomb_friction": _coulomb,
    "stribeck_friction": _stribeck,
    "quadratic_drag": _drag,
    "load_dependent_friction": _load,
    "asymmetric_friction": _asymmetric,
    "position_dependent_friction": _position,
    "hysteretic_friction": _hysteretic,
    "actuator_gain": _gain,
    "actuator_saturation": _saturation,
    "actuator_dead_zone": _dead_zone,
    "actuator_lag": _lag,
    "actuator_delay": _delay,
    "spring": _spring,
    "constant_force": _constant,
    "gravity_tilt": _tilt,
    "cogging": _cogging,
    "external_pulse": _pulse,
    "external_periodic": _periodic,
    "added_inertia": _inertia,
    "base_motion": _base,
    "backlash": _backlash,
    "joint_flexibility": _flexible,
    "end_stop": _stop,
    "sensor_latency": _latency,
    "clock_drift": _clock,
    "parameter_drift": _parameter_drift,
}
"""Draws of effects, by their id in the taxonomy."""
ACTUATION = ("actuator_gain", "actuator_saturation", "actuator_dead_zone", "actuator_lag", "actuator_delay")
DRIVEN = (*ACTUATION, "backlash", "joint_flexibility", "sensor_latency")
"""Effects that show nothing without commands."""
GLOBAL = ("gravity_tilt", "base_motion", "sensor_latency", "clock_drift")
"""Effects that have no joint of their own."""


def place(mechanism: CaseMechanism, site: Site) -> dict[str, str]:
    """Kind and name of where a mechanism of the taxonomy is."""
    if mechanism.id in ("gravity_tilt", "base_motion"):
        return {"kind": "world", "name": "world"}
    if mechanism.id in ("sensor_latency", "clock_drift"):
        return {"kind": "sensor", "name": "clock"}
    if mechanism.id in ACTUATION:
        return {"kind": "actuator", "name": site.motor}
    return {"kind": "joint", "name": site.name}
