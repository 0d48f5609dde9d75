"""The physics of sealed cases against closed forms and energy; every mechanism does something."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.blind.mechanism import Run
from keycld_control.benchmarks.blind.mechanisms import actuation, forces, friction, measurement, structure
from keycld_control.benchmarks.blind.outside_strengths import OUTSIDE, possible
from keycld_control.benchmarks.blind.plant import STEP, CasePlant, PlantTrajectory
from keycld_control.benchmarks.blind.sites import SITES
from keycld_control.benchmarks.blind.strengths import LIBRARY
from keycld_envs.systems import get_system

GRAVITY = 9.81
MASS, LENGTH, INERTIA, GEAR = 1.0, 0.5, 0.251, 2.0
"""Of the pendulum: kg, m, kg m^2 about the hinge, N m per command."""


def run(mechanisms, q: Any = 2.0, v: Any = 0.0, u=0.0, seconds=1.0, gravity=True, system="pendulum") -> PlantTrajectory:
    """The motion for commands that are zero until 50 ms, then u."""
    model = get_system(system).compile()
    if not gravity:
        model.opt.gravity[:] = 0
    q, v = np.broadcast_to(q, model.nv).astype(float), np.broadcast_to(v, model.nv).astype(float)
    ticks = np.arange(0, round(seconds / STEP), 50)
    path = CasePlant(model, mechanisms).simulate(
        q, v, ticks, lambda tick, y: np.full(model.nu, u * (tick > 0)), np.random.default_rng(0), seconds
    )
    assert path is not None and np.isfinite(path.q).all()
    return path


def energy(path: PlantTrajectory) -> np.ndarray:
    """Of the pendulum, J."""
    return 0.5 * INERTIA * path.v[:, 0] ** 2 + MASS * GRAVITY * LENGTH * np.cos(path.q[:, 0])


@pytest.mark.parametrize(
    "mechanism, power",
    [
        (None, lambda v: 0 * v),
        (friction.Viscous(0, -1, 0.1), lambda v: 0.1 * v**2),
        (friction.Drag(0, -1, 0.05), lambda v: 0.05 * np.abs(v) ** 3),
        (friction.Coulomb(0, -1, 0.2), lambda v: 0.2 * np.abs(v)),
        (friction.Stribeck(0, -1, 0.1, 0.3, 1.0), lambda v: (0.1 + 0.2 * np.exp(-(v**2))) * np.abs(v)),
        (friction.Asymmetric(0, -1, 0.3, 0.1), lambda v: np.where(v > 0, 0.3, 0.1) * np.abs(v)),
    ],
    ids=["none", "viscous", "drag", "coulomb", "stribeck", "asymmetric"],
)
def test_friction_takes_the_energy_that_its_formula_says(mechanism, power):
    path = run([mechanism] if mechanism else [], seconds=2.0)
    lost, power = energy(path)[0] - energy(path)[-1], power(path.v[:, 0])
    assert lost == pytest.approx(STEP * np.sum((power[1:] + power[:-1]) / 2), abs=5e-5)
    assert np.ptp(path.q) > 1


def test_dry_friction_holds_a_joint_exactly_until_the_load_exceeds_it():
    load = MASS * GRAVITY * LENGTH * np.sin(np.pi - 2.0)
    for c, holds in ((1.01 * load, True), (0.99 * load, False)):
        assert (np.ptp(run([friction.Coulomb(0, -1, c)]).q) < 1e-12) == holds
    stopped = run([friction.Coulomb(0, -1, 1.0)], v=3.0, seconds=4.0)
    assert np.abs(stopped.v[-500:]).max() < 1e-6
    assert np.ptp(stopped.q) > 0.3


def test_two_joints_hold_each_other_still():
    friction_of_both = [friction.Coulomb(0, -1, 30.0), friction.Coulomb(1, -1, 30.0)]
    assert np.ptp(run(friction_of_both, system="acrobot").q, axis=0).max() < 1e-6


def test_load_dependent_friction_feels_weight_and_centrifugal_force():
    model = get_system("pendulum").compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = np.pi, 3.0
    mujoco.mj_forward(model, data)
    limits = friction.LoadDependent(0, -1, 0.01).dry_friction(Run(model, data, np.random.default_rng(0), 1.0))
    assert limits(None)[0] == pytest.approx(0.01 * MASS * (GRAVITY + LENGTH * 3.0**2))  # pyright: ignore[reportArgumentType]


def test_bristles_are_springs_before_they_slide():
    """A push of a hundredth of c deflects by it over the stiffness, and slides by nothing to speak of."""
    lugre = friction.LuGre(0, -1, 1.0, 1.2, 0.1, 50.0, 2.0)
    path = run([lugre, forces.Constant(0, -1, 0.01)], q=0.0, gravity=False, seconds=1.0)
    assert path.q[-1, 0] == pytest.approx(0.01 / 50, rel=0.05)


def test_a_flexible_joint_swings_as_two_inertias_on_a_spring():
    rotor, k = 0.05, 40.0
    path = run([structure.Flexible(0, 0, rotor, k, 0.0)], q=0.0, v=0.0, u=1.0, gravity=False, seconds=1.0)
    rate = np.sqrt(k * (1 / rotor + 1 / INERTIA))
    t = np.arange(len(path.q)) * STEP + path.start - 0.05
    twist = GEAR / rotor / rate**2
    expected = GEAR / (rotor + INERTIA) * t**2 / 2 - k / INERTIA * twist / rate**2 * (1 - np.cos(rate * t))
    np.testing.assert_allclose(path.q[:, 0], np.where(t > 0, expected, 0), atol=2e-4)


def test_backlash_lets_the_motor_turn_until_it_touches():
    """A rotor with no torque before starts in the middle: it flies through half the play, then pushes."""
    half, rotor = 0.2, 0.05
    path = run([structure.GearPlay(0, 0, rotor, half, 500.0, 1.0)], q=0.0, u=1.0, gravity=False)
    touch = np.sqrt(2 * half * rotor / GEAR) + 0.05
    moved = path.start + STEP * int(np.argmax(np.abs(path.q[:, 0]) > 1e-6))
    assert moved == pytest.approx(touch, abs=0.004)


@pytest.mark.parametrize(
    "mechanism, mass, moment",
    [(structure.Rotor(0, -1, 0.1), 0.0, 0.1), (structure.PointMass(0, -1, 0.4, 0.8), 0.4 * 0.8, 0.4 * 0.8**2)],
)
def test_added_inertia_slows_small_swings(mechanism, mass, moment):
    rate = np.sqrt(GRAVITY * (MASS * LENGTH + mass) / (INERTIA + moment))
    path = run([mechanism], q=np.pi + 0.01, seconds=2.0)
    expected = 0.01 * np.cos(rate * STEP * np.arange(len(path.q)))
    np.testing.assert_allclose(path.q[:, 0] - np.pi, expected, atol=1e-5)


def test_a_moving_base_moves_the_rail_under_the_cart():
    """Cart and pole stay where they are in the world; relative to the rail they swing back."""
    size, w = 0.02, 5.0
    path = run([forces.BaseVibration(-1, -1, size, w, 0.0, False)], q=[0.0, np.pi], v=[0.0, 0.0], system="cartpole")
    t = STEP * np.arange(len(path.q)) + path.start
    start = size * (np.sin(w * t) - np.sin(w * t[0]) - w * np.cos(w * t[0]) * (t - t[0]))
    np.testing.assert_allclose(path.q[:, 0], -start, atol=2e-6)
    np.testing.assert_allclose(path.q[:, 1], np.pi, atol=1e-9)


def test_tilt_moves_the_rest():
    path = run([forces.Tilt(-1, -1, 0.1)], q=np.pi - 0.1, seconds=1.0)
    assert np.ptp(path.q) < 1e-9


def test_motors_lag_and_wait():
    runner = Run(get_system("pendulum").compile(), None, np.random.default_rng(0), 1.0)  # pyright: ignore[reportArgumentType]
    told = [0.0] * 10 + [1.0] * 100
    lag, late = actuation.Lag(0, 0, 0.02).motor(runner), actuation.Delay(0, 0, 0.0123).motor(runner)
    followed, shifted = ([motor(0.0, u) for u in told] for motor in (lag, late))
    assert np.sum(np.array(told) - followed) * STEP == pytest.approx(0.02 * (1 - np.exp(-100 / 20)))
    assert np.sum(np.array(told) - shifted) * STEP == pytest.approx(0.0123)
    assert shifted[21] == 0.0 and shifted[23] == 1.0


def test_sensors_show_the_past_and_clocks_stretch():
    t = np.array([0.0, 1.0, 2.0])
    plant = CasePlant(
        get_system("pendulum").compile(), [measurement.Latency(-1, -1, 0.01), measurement.Drift(-1, -1, 0.02)]
    )
    np.testing.assert_allclose(plant.measured_times(t), 1.02 * (t - 0.01))


def _somewhere():
    """Every kind at one of its places, which take turns."""
    for kinds in (LIBRARY, OUTSIDE):
        for i, kind in enumerate(kinds):
            places = [s for s in SITES if kinds is LIBRARY or possible(kind, s, True)]
            site = places[i % len(places)]
            yield pytest.param(kinds[kind], site, id=f"{kind}-{site.name}")


@pytest.mark.parametrize("draw, site", list(_somewhere()))
def test_every_mechanism_changes_what_is_seen(draw, site):
    mechanism = draw(site, np.random.default_rng(3), True)
    if isinstance(mechanism, forces.CompliantStop):
        mechanism = replace(mechanism, at=site.rest + 0.1 * mechanism.side)
    if isinstance(mechanism, forces.Pushes):
        mechanism = replace(mechanism, width=0.08)
    rest = np.array([s.rest for s in SITES if s.system == site.system])
    shown = []
    for mechanisms in ([], [mechanism]):
        model = get_system(site.system).compile()
        plant = CasePlant(model, mechanisms)
        path = plant.simulate(
            rest + 0.4,
            np.full(model.nv, 0.5),
            np.arange(0, 900, 100),
            lambda tick, y: np.full(y.shape, (-1) ** tick * site.command),
            np.random.default_rng(0),
            0.9,
        )
        assert path is not None
        shown.append(path.at(plant.measured_times(np.linspace(0, 0.9, 100))))
    assert np.isfinite(shown[1]).all()
    assert np.abs(shown[1] - shown[0]).max() > 1e-6
