from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from oracle import SYSTEMS, body_of, make_oracle, point_masses

from keycld_control.plant import Plant
from keycld_control.pumping import PumpState, gravity_load, plan_pumping, pumping_action
from keycld_control.skeleton import rod_vectors
from keycld_envs import get_system
from keycld_envs.effects import CoulombFriction
from keycld_model.added_effects import added_effects
from keycld_model.physics import PointMasses

DEFAULT = {"pendulum": 3.0, "cartpole": 3.0, "acrobot": 15.0}


def plan(name: str, limit: float):
    target = jnp.asarray(point_masses(name, (0.0, 0.0)), jnp.float32)
    bounds = jnp.full(get_system(name).mechanism.num_actions, limit)
    plant = Plant.of(make_oracle(name))
    return plan_pumping(plant, target, -bounds, bounds), gravity_load(plant, target, -bounds, bounds)


@pytest.mark.parametrize("name", SYSTEMS)
def test_default_limits_lift_directly(name):
    assert plan(name, DEFAULT[name])[0] is None


@pytest.mark.parametrize(
    ("name", "limit", "load"),
    [
        ("pendulum", 3.0, [0.5 * 9.81 / 6]),
        ("acrobot", 3.0, [2 * 9.81 / 6, 0.5 * 9.81 / 6]),  # the greatest moments are those of outstretched arms
        ("cartpole", 0.2, [0.0, 0.05 * 9.81 / 0.2]),
    ],
)
def test_gravity_load_is_that_of_statics(name, limit, load):
    np.testing.assert_allclose(plan(name, limit)[1], load, rtol=5e-3, atol=1e-5)


def with_friction(c: float) -> Plant:
    """A pendulum whose hinge has dry friction, N m."""
    exact = make_oracle("pendulum")
    points = PointMasses(exact.mechanism, exact.masses, exact.level, exact.pivot)
    known = exact.potential_energy_fn, exact.input_matrix_fn
    added = added_effects([CoulombFriction("hinge", c)], get_system("pendulum"), exact.timestep, points, *known)
    return Plant.of(replace(exact, added=added))


def test_friction_is_lifted_too():
    plant, target, bound = (
        with_friction(1.68),
        jnp.asarray(point_masses("pendulum", (0.0,)), jnp.float32),
        jnp.array([3.0]),
    )
    np.testing.assert_allclose(gravity_load(plant, target, -bound, bound), [(0.5 * 9.81 + 1.68) / 6], rtol=5e-3)
    assert plan_pumping(plant, target, -bound, bound) is not None
    assert plan_pumping(with_friction(0.1), target, -bound, bound) is None


@pytest.mark.parametrize("angle", [-1.5, 1.5])
def test_what_friction_holds_on_a_slope_starts_downhill(angle):
    plant, target, bound = (
        with_friction(1.68),
        jnp.asarray(point_masses("pendulum", (0.0,)), jnp.float32),
        jnp.array([3.0]),
    )
    pump = plan_pumping(plant, target, -bound, bound)
    assert pump is not None
    x = jnp.asarray(point_masses("pendulum", (angle,)), jnp.float32)
    for direction in (-1.0, 1.0):
        state = PumpState(jnp.array(False), jnp.array(direction))
        state, action = pumping_action(plant, pump, state, x, 0 * x, target, 40.0, 10.0, -bound, bound)
        assert not state.caught
        np.testing.assert_allclose(action, 3 * np.sign(angle))


def test_a_weak_shoulder_pumps_with_a_straight_arm():
    pump, _ = plan("acrobot", 3.0)
    assert pump is not None and pump.actuator == 0
    plant = Plant.of(make_oracle("acrobot"))
    lengths = body_of("acrobot").unit * body_of("acrobot").lengths
    for x in pump.curve[::20]:
        upper, lower = rod_vectors(plant.mechanism, x, plant.pivot)
        np.testing.assert_allclose(lower / lengths[1], upper / lengths[0], atol=5e-3)
    angles = np.arctan2(pump.curve[:, 0], pump.curve[:, 1])
    assert np.ptp(angles) > 6.2  # all the way round
    top, bottom = (float(plant.potential_energy(jnp.asarray(point_masses("acrobot", (q, 0.0))))) for q in (0.0, np.pi))
    np.testing.assert_allclose(pump.span, top - bottom, rtol=1e-3)
    np.testing.assert_allclose(pump.energy, top + 0.02 * (top - bottom), rtol=1e-3)


def test_a_weak_pole_pumps_with_the_cart_in_place():
    pump, _ = plan("cartpole", 0.2)
    assert pump is not None and pump.actuator == 1
    np.testing.assert_allclose(pump.curve[:, :2], 0.0, atol=5e-3)


def test_late_motors_do_not_keep_it_from_being_caught():
    pump, _ = plan("acrobot", 3.0)
    assert pump is not None
    plant, target = Plant.of(make_oracle("acrobot")), jnp.asarray(point_masses("acrobot", (0.0, 0.0)), jnp.float32)
    told_before = jnp.array([3.0, 0.4])  # the elbow does what it was told before, whatever is decided now
    state = PumpState(jnp.array(False), jnp.array(1.0))
    state, _ = pumping_action(
        plant, pump, state, target, 0 * target, target, 40.0, 10.0, jnp.array([-3.0, 0.4]), told_before
    )
    assert state.caught


def test_a_plan_ends_where_a_model_has_no_answer():
    exact = make_oracle("pendulum")
    target, bound = jnp.asarray(point_masses("pendulum", (0.0,)), jnp.float32), jnp.array([0.5])

    def ends(x):
        return jnp.where(x[1] > 0, exact.input_matrix_fn(x), 0.0)

    pump = plan_pumping(replace(Plant.of(exact), input_matrix=ends), target, -bound, bound)
    assert pump is not None
    assert np.isfinite(pump.curve).all() and np.isfinite([pump.energy, pump.span]).all() and pump.span > 0
