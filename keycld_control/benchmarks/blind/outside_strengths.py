"""Draws physics outside the taxonomy, most of it clear."""

import numpy as np

from keycld_control.benchmarks.blind.mechanism import CaseMechanism
from keycld_control.benchmarks.blind.mechanisms import outside
from keycld_control.benchmarks.blind.sites import Site, sites
from keycld_control.benchmarks.blind.strengths import Draw, log_uniform, sign
from keycld_envs.systems import get_system


def _magnet(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    width = float(rng.uniform(0.08, 0.2)) * (0.5 if s.slide else 1)
    return outside.Magnet(
        s.joint, -1, s.torque * log_uniform(rng, 0.1, 0.8), s.rest + s.swing * float(rng.uniform(-0.6, 0.6)), width
    )


def _wind(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    speed, reach = log_uniform(rng, 1.5, 5), float(rng.uniform(0.5, 1.0))
    c = s.torque * log_uniform(rng, 0.05, 0.4) / speed**2 / reach
    return outside.Wind(s.joint, -1, reach, c, speed * sign(rng), float(rng.uniform(1.0, 4.0)))


def _slosh(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return outside.Slosh(
        s.joint,
        -1,
        float(rng.uniform(0.6, 1.0)),
        s.mass * log_uniform(rng, 0.08, 0.4),
        float(rng.uniform(8, 20)),
        float(rng.uniform(0.02, 0.1)),
    )


def _speed_law(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return outside.SpeedLaw(s.joint, -1, s.torque * log_uniform(rng, 0.05, 0.3), s.speed * float(rng.uniform(0.4, 0.8)))


def _efficiency(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    n = float(rng.uniform(3, 8)) if s.slide else float(rng.integers(2, 5))
    return outside.Efficiency(s.joint, s.joint, log_uniform(rng, 0.15, 0.6), n)


def _relaxation(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return outside.Relaxation(s.joint, -1, s.torque * log_uniform(rng, 0.15, 1.0), float(rng.uniform(0.1, 0.5)))


def _cross(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return outside.Cross(s.joint, -1, sign(rng) * s.torque / s.speed * log_uniform(rng, 0.05, 0.25))


def _gyroscope(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    return outside.Gyroscope(s.joint, -1, sign(rng) * s.torque / s.speed * log_uniform(rng, 0.05, 0.25))


def _cable(s: Site, rng: np.random.Generator, driven: bool) -> CaseMechanism:
    ratio = sign(rng) * float(rng.uniform(0.6, 1.5))
    first, second = get_system(s.system).hanging_qpos
    length = first + ratio * second + float(rng.uniform(0.1, 0.5))
    return outside.Cable(s.joint, -1, s.torque * log_uniform(rng, 1, 12), ratio, length)


OUTSIDE: dict[str, Draw] = {
    "magnet": _magnet,
    "wind": _wind,
    "slosh": _slosh,
    "speed_law": _speed_law,
    "efficiency": _efficiency,
    "relaxation": _relaxation,
    "cross_coupling": _cross,
    "gyroscope": _gyroscope,
    "cable": _cable,
}
"""Draws of kinds of physics outside the taxonomy, by kind."""


def possible(kind: str, site: Site, driven: bool) -> bool:
    """Whether a kind can be at a site and shows there."""
    if kind in ("cross_coupling", "gyroscope", "cable"):  # the last two act on both joints: the lighter one's sizes
        return len(sites(site.system)) == 2 and (kind == "cross_coupling" or site.joint == 1)
    if kind in ("wind", "slosh"):
        return not site.slide
    return driven or kind != "efficiency"
